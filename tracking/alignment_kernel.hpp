// Inner loops of the pattern alignment, compiled once per instruction set and chosen at run time.
//
// Everything here is plain arrays of float in structure-of-arrays layout: a file that is compiled
// for a wider instruction set must not instantiate templates that other files share. Sums run in 16
// fixed lanes and no product is fused with a sum, so every variant gives the same bits.
//
// Lattice coordinates (a, b) are those of tag_pattern.hpp; "ray" is (x, y) of the direction
// (x, y, 1) in the camera frame, without distortion.
#pragma once

#include <cstddef>
#include <cstdint>

namespace penumbra::kernel {

inline constexpr int kBlock = 64;  // sample arrays are padded to a multiple of this

struct Lens {
  float fx = 0.0F, fy = 0.0F, cx = 0.0F, cy = 0.0F;  // [px]
  // polynomial: k4 k5 k6 (the denominator of the rational model) are 0
  enum class Kind { none, polynomial, rational, fisheye } kind = Kind::none;
  float k[8] = {};  // k1 k2 p1 p2 k3 k4 k5 k6, or k1..k4 of the fisheye
};

// How the image is blurred, as variances in pixels: what the lens and the pixel's box do, and the
// image's motion during the exposure (a box along `motion`, by its variance).
struct Blur {
  float variance_px2 = 0.0F;
  float motion_x_px = 0.0F, motion_y_px = 0.0F;
};

// Lattice points (a, b) -> ray, pixel, depth (<= 0: behind the camera), and the blur there.
// ka, kb: 1 / sigma along a and b [1/cells]; rho: their correlation.
struct Vertices {
  int count = 0;  // multiple of 16
  const float* a = nullptr;
  const float* b = nullptr;
  float* ray_x = nullptr;
  float* ray_y = nullptr;
  float* pixel_x = nullptr;
  float* pixel_y = nullptr;
  float* depth = nullptr;
  float* ka = nullptr;
  float* kb = nullptr;
  float* rho = nullptr;
};

// One tag's samples: pixels with their grey levels and what the model needs of them. The model is
// anchored at the lattice vertex (va, vb) nearest to the pixel (with two lines per axis: the vertex
// below and left of it); `c` are its coefficients (see
// pattern in the body), ka, kb and rho its blur.
struct Samples {
  int count = 0;  // multiple of kBlock; padding has weight 0
  float* pixel_x = nullptr;
  float* pixel_y = nullptr;
  float* ray_x = nullptr;
  float* ray_y = nullptr;
  float* value = nullptr;
  float* weight = nullptr;
  std::int32_t* vertex = nullptr;  // of the anchor: vb * side + va
  float* va = nullptr;
  float* vb = nullptr;
  float* ka = nullptr;
  float* kb = nullptr;
  float* rho = nullptr;
  float* c[16] = {};
  float* model = nullptr;     // out of evaluate: the pattern's blurred value, 0 black to 1 white
  float* residual = nullptr;  // out of accumulate
};

// Normal equations of one tag, parameters (nu, omega) of the right perturbation of
// T_camera_lattice [cells, rad], gain, offset; residual = value - (gain * model + offset).
struct Sums {
  double H[36] = {};         // upper triangle of the 8x8 matrix, row by row
  double g[8] = {};          // J^T W r, with J = -d residual / d parameters
  double cost = 0.0;         // sum of w r^2
  double weight = 0.0;       // sum of w
  double base_weight = 0.0;  // sum of the samples' own weights
};

struct AccumulateInput {
  float lattice_from_ray[9] = {};
  float centre[3] = {};  // the camera's centre in the lattice frame [cells]
  float gain = 0.0F, offset = 0.0F;
  float inverse_cutoff = 0.0F;  // of Tukey's weights [1 / grey]; 0: none
  int reach = 1;                // lines per axis that matter: 1, 2 or 3
  bool correlated = false;      // whether rho is used
};

struct Variant {
  const char* name;
  void (*project)(const Lens& lens, const Blur& blur, const float* ray_from_lattice,
                  const float* lattice_from_ray, const Vertices& vertices);
  // Rays of the pixels (ray_x, ray_y hold a guess within a few pixels), and their anchor on a
  // lattice of side x side vertices.
  void (*prepare)(const Lens& lens, const float* lattice_from_ray, int reach, int side,
                  const Samples& samples);
  void (*accumulate)(const AccumulateInput& input, const Samples& samples, Sums& sums);
  // The model alone, at the pose of `input`, into samples.model.
  void (*evaluate)(const AccumulateInput& input, const Samples& samples);
  // scores[r * columns + c] = sum over the first `positive` points minus the sum over the others of
  // point[r * row_step * stride + c]; columns: 32 or 64.
  void (*search)(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
                 int count, int columns, int rows, int row_step, std::int16_t* scores);
};

// The widest variant that this processor runs.
[[nodiscard]] const Variant& best_variant();
// All that this processor runs, narrowest first; null ends the list.
[[nodiscard]] const Variant* const* available_variants();

}  // namespace penumbra::kernel
