// Inner loops of the pattern alignment, compiled for each instruction set and chosen at run time.
//
// Everything here is plain arrays of float in structure-of-arrays layout: a file that is compiled
// for a wider instruction set must not instantiate templates that other files share. Sums run in 16
// fixed lanes and no product is fused with a sum, so every instruction set gives the same bits.
//
// Lattice coordinates (a, b) are those of tag_pattern.hpp; "ray" is (x, y) of the direction
// (x, y, 1) in the camera frame, without distortion.
#pragma once

#include <cstddef>
#include <cstdint>

namespace penumbra {
class CameraModel;
}

namespace penumbra::simd {

inline constexpr int kBlock = 64;  // sample arrays are padded to a multiple of this

struct Lens {
  float fx = 0.0F, fy = 0.0F, cx = 0.0F, cy = 0.0F;  // [px]
  // polynomial: k4 k5 k6 (the denominator of the rational model) are 0
  enum class Kind { none, polynomial, rational, fisheye } kind = Kind::none;
  float k[8] = {};  // k1 k2 p1 p2 k3 k4 k5 k6, or k1..k4 of the fisheye
  // Squared radius of rays beyond which the model folds back; infinite when it never does.
  float max_radius2 = __builtin_inff();
};

// How the image is blurred, as variances in pixels: what the lens and the pixel's box do, and the
// image's motion during the exposure (a box along `motion`, by its variance).
struct Blur {
  float variance_px2 = 0.0F;
  float motion_x_px = 0.0F, motion_y_px = 0.0F;
};

// Lattice points (a, b) -> ray, pixel, depth (<= 0: behind the camera or beyond the lens model),
// and the blur there. ka, kb: 1 / sigma along a and b [1/cells]; rho: their correlation. Arrays
// that are not wanted are null: rho, or rays, ka, kb and rho.
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
// below and left of it); `c` are its coefficients (see pattern() in residuals_body.hpp), ka, kb and
// rho its blur.
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
  // Out of leverage: for each sample its leverage times its residual and times its slope, and after
  // all `count` of these the squares of the leverages.
  float* leverage = nullptr;
};

// Four tags side by side in a step, the last index the tag. Matrices by rows.
struct TagPack {
  double H[36][4] = {};  // of Sums; zero for a tag that is left out
  double g[8][4] = {};
  double weight[4] = {};
  double R[9][4] = {};  // lattice from camera
  double centre[3][4] = {};
  double per_cell[4] = {};             // [1/m]
  double ray_from_lattice[9][4] = {};  // where the tag is, before the step
  double side_cells[4] = {};
  // Out of marginalise: whether the tag takes part; the inverse of its gain's and offset's
  // equations; and its share in those of the camera's motion, gain and offset solved for: upper
  // triangle of [nu nu, nu omega; , omega omega], as 6, 9 and 6 numbers, and gradient.
  bool valid[4] = {};
  double inverse[3][4] = {};
  double H_camera[21][4] = {};
  double g_camera[6][4] = {};
  // Out of follow: by how much gain and offset change, and how far the farthest of the tag's
  // corners goes [rays squared, each axis times the focal length].
  double levels[2][4] = {};
  double moved_px2[4] = {};
};

// A step of the camera: left perturbation of T_camera_table, and the motion it is. `slope`: the
// share of H that it was solved with.
struct CameraStep {
  double xi[6] = {};
  double R[9] = {};
  double t[3] = {};
  double fx = 0.0, fy = 0.0;
  double slope = 1.0;
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

// Steps along edges of one of the lattice's two directions, and the pixels across the edge at each.
// Edges are walked along the image axis they are nearer to: a step is at the nearest pixel's centre
// along that axis, and takes the pixels across within `reach_px` of the edge, or, with a band,
// those at its offsets from the edge's own pixel.
struct Walk {
  // All edges of the direction one behind the other, by their cells: a place at distance d along
  // them is at begin + d in the edge's direction and at `across` in the other, with the record of
  // cell floor(d); there is one record more than cells.
  struct Cell {
    float begin = 0.0F, across = 0.0F;
    std::int32_t run = 0;  // which edge it is of
  };
  const Cell* cells = nullptr;
  int cell_count = 0;
  int count = 0;                            // of steps, evenly over all cells
  const float* ray_from_lattice = nullptr;  // 3 x 3, by rows
  bool along_b = false;                     // which way the edges go in the lattice
  bool along_x = false;                     // and which way they are walked in the image
  int width = 0, height = 0;                // of the image
  std::ptrdiff_t stride = 0;                // from an image row to the next [bytes]
  float reach_px = 0.0F;                    // at right angles to the edge
  int most_rows = 0;                        // pixels at a step
  int band_count = 0;                       // 0: all within reach
  const float* offsets = nullptr;           // 0, 1, 2 ..., or the band's; 20 of them
  // A point at row y is seen displaced by shear (y - row), see Tag::row_shear.
  float row = 0.0F, shear_x = 0.0F, shear_y = 0.0F;
  // Out, for each step: where its samples end, and its run (up to a multiple of 16).
  std::int32_t* end = nullptr;
  std::int32_t* run = nullptr;
};

// Edges of a tag, each walked pixel by pixel along the image axis it is nearer to.
struct RunWalk {
  struct Run {
    std::uint32_t begin = 0, end = 0;  // vertices
    bool vertical = false;             // in the lattice
  };
  // Sixteen runs side by side, out of measure_runs. "Along" is the axis of the walk, "across" the
  // other one.
  struct Part {
    static constexpr int kRuns = 16;
    alignas(64) double length[kRuns];          // [px along]; -1: not to be walked
    double along_px[kRuns], across_px[kRuns];  // how far the run goes; 0 where it is not seen
    double along[kRuns], across[kRuns];        // where it begins [px]
    double direction[kRuns], slope[kRuns];     // of the walk, 1 or -1, and across by along
    double reach[kRuns];                       // across [px]
    double ray_x[kRuns], ray_y[kRuns];         // where it begins
    double per_px_x[kRuns], per_px_y[kRuns];   // and by how much the ray changes along
    std::int32_t along_x[kRuns];               // whether along is x
  };
  const Run* runs = nullptr;
  int count = 0;
  const float* ray_x = nullptr;  // of the vertices, as in Vertices
  const float* ray_y = nullptr;
  const float* pixel_x = nullptr;
  const float* pixel_y = nullptr;
  const float* depth = nullptr;
  Part* parts = nullptr;           // (count + 15) / 16
  double reach_px = 0.0;           // at right angles to the edge
  double stride_px = 0.0;          // along, from step to step and on from run to run
  int width = 0, height = 0;       // of the image
  std::ptrdiff_t stride = 0;       // from an image row to the next [bytes]
  int most_rows = 0;               // pixels at a step
  int band_count = 0;              // as in Walk
  const float* offsets = nullptr;  // as in Walk
  // Out, for each run with a step: where its samples end, and which run it is; and how many.
  std::int32_t* end = nullptr;
  std::int32_t* run = nullptr;
  int walked = 0;
};

inline constexpr std::int32_t kNowhere = INT32_MIN;

struct CellCorners {  // of Vertices
  const float* pixel_x = nullptr;
  const float* pixel_y = nullptr;
  const float* depth = nullptr;
};

struct ImagePlan {
  int width = 0, height = 0;
  std::ptrdiff_t stride = 0;  // from row to row [bytes]
};

struct AccumulateInput {
  float lattice_from_ray[9] = {};
  float centre[3] = {};  // the camera's centre in the lattice frame [cells]
  float gain = 0.0F, offset = 0.0F;
  float inverse_cutoff = 0.0F;  // of Tukey's weights [1 / grey]; 0: none
  int reach = 1;                // lines per axis that matter: 1, 2 or 3
  bool correlated = false;      // whether rho is used
};

// For the effect of a displacement of the edges on the residuals of the last accumulate.
struct LeverageInput {
  float inverse_gain = 0.0F;
  float offset = 0.0F;
  float inverse_limit = 0.0F;  // of Tukey's weights [1 / share of the gain]
};

struct Loops {
  const char* name;
  void (*project)(const Lens& lens, const Blur& blur, const float* ray_from_lattice,
                  const float* lattice_from_ray, const Vertices& vertices);
  // Writes pixels, guesses of their rays and, for `vertex`, their places in the image's memory,
  // from sample `used` on and up to three more than there are; returns where they end.
  int (*walk)(const Lens& lens, const Walk& walk, const Samples& samples, int used);
  // Fills `parts`; returns the sums of along_px and across_px.
  void (*measure_runs)(const RunWalk& walk, double& along_px, double& across_px);
  // From the first sample on; writes and returns what `walk` does.
  int (*walk_runs)(const Lens& lens, RunWalk& walk, const Samples& samples);
  // Values of the first `used` samples by their places in the image's memory (in `vertex`) and the
  // levels' 256 values, and weights of 1; fills up pixels, rays, values and weights to `count`.
  void (*read)(const std::uint8_t* pixels, const float* levels, int used, const Samples& samples);
  // Rays of the pixels (ray_x, ray_y hold a guess within a few pixels), and their anchor on a
  // lattice of side x side vertices.
  void (*prepare)(const Lens& lens, const float* lattice_from_ray, int reach, int side,
                  const Samples& samples);
  // ka, kb and c of the samples' vertices, for one line per axis: by those of all vertices, four
  // coefficients each.
  void (*attach)(const float* ka, const float* kb, const float* coefficients,
                 const Samples& samples);
  void (*accumulate)(const AccumulateInput& input, const Samples& samples, Sums& sums);
  // The anchors alone, by the rays.
  void (*anchor)(const float* lattice_from_ray, int reach, int side, const Samples& samples);
  // Gains and offsets solved for in terms of the camera's motion; returns nothing but in the packs.
  void (*marginalise)(TagPack* packs, int count);
  // What the step does to the tags.
  void (*follow)(const CameraStep& step, TagPack* packs, int count);
  // The model alone, at the pose of `input`, into samples.model.
  void (*evaluate)(const AccumulateInput& input, const Samples& samples);
  // The mean of what is seen at `count` moments: `inputs` are where the camera is then, `moments`
  // the same samples, each with the anchor and the blur that it has then.
  void (*evaluate_moments)(const AccumulateInput* inputs, const Samples* moments, int count);
  void (*leverage)(const LeverageInput& input, const Samples& samples);
  // scores[r * columns + c] = sum over the first `positive` points minus the sum over the others of
  // point[r * row_step * stride + c]; columns: 32 or 64.
  void (*search)(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
                 int count, int columns, int rows, int row_step, std::int16_t* scores);
  // sums[k] += scores[k]
  void (*add)(const std::int16_t* scores, int count, std::int32_t* sums);
  // Of the cell above and right of each vertex of a lattice of side x side: where the pixel nearest
  // to its centre, the mean of its corners, lies in the image's memory; kNowhere where there is
  // none. The last vertex of a row has no cell, and the last row has none.
  void (*cell_places)(int side, const CellCorners& corners, const ImagePlan& image,
                      std::int32_t* places);
};

[[nodiscard]] Lens lens_of(const CameraModel& camera);
// The widest that this processor runs.
[[nodiscard]] const Loops& widest_loops();
// All that this processor runs, narrowest first; null ends the list.
[[nodiscard]] const Loops* const* available_loops();

}  // namespace penumbra::simd
