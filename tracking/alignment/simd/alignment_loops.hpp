// Inner loops of the pattern alignment, compiled for each instruction set and chosen at run time.
// Every instruction set gives the same bits: sums run in 16 fixed lanes and no product is fused
// with a sum. Data are plain arrays of float, because code for a wider instruction set must not
// instantiate templates that other files share.
//
// Lattice coordinates (a, b) are those of tag_pattern.hpp. A ray is (x, y) of the direction (x, y,
// 1) in the camera frame, without distortion.
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
  // polynomial: the rational model with k4 = k5 = k6 = 0
  enum class Kind { none, polynomial, rational, fisheye } kind = Kind::none;
  float k[8] = {};  // k1 k2 p1 p2 k3 k4 k5 k6, or k1..k4 of the fisheye
  // Squared radius of rays beyond which the distortion is not monotonic; may be infinite.
  float max_radius2 = __builtin_inff();
};

// Variance of the blur by the lens and the pixel's box, and motion during the exposure.
struct Blur {
  float variance_px2 = 0.0F;
  float motion_x_px = 0.0F, motion_y_px = 0.0F;
};

// Projects lattice points; depth <= 0: behind the camera or beyond the lens model. ka, kb: 1 /
// sigma of the blur along a and b [1/cells]; rho: their correlation. Arrays may be null: rho, or
// rays, ka, kb and rho.
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

// Samples of one tag. The model is anchored at the lattice vertex (va, vb) nearest to the pixel
// (with two lines per axis: below and left of it), with coefficients `c`, see pattern() in
// residuals_body.hpp.
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
  float* model = nullptr;     // by evaluate: the pattern's blurred value, 0 black to 1 white
  float* residual = nullptr;  // by accumulate
  // By leverage: pairs of leverage times residual and times slope, then `count` squared leverages.
  float* leverage = nullptr;
};

// Four tags in a step; the last index is the tag. Matrices by rows.
struct TagPack {
  double H[36][4] = {};  // of Sums; zero for a tag without equations
  double g[8][4] = {};
  double weight[4] = {};
  double R[9][4] = {};  // lattice from camera
  double centre[3][4] = {};
  double per_cell[4] = {};             // [1/m]
  double ray_from_lattice[9][4] = {};  // where the tag is, before the step
  double side_cells[4] = {};
  // By marginalise: validity, inverse of the equations of gain and offset, and marginalised
  // equations of the camera's motion: [nu nu, nu omega; , omega omega] as 6, 9 and 6 numbers, and
  // gradient.
  bool valid[4] = {};
  double inverse[3][4] = {};
  double H_camera[21][4] = {};
  double g_camera[6][4] = {};
  // By follow: changes of gain and offset, and the farthest corner's squared motion [px^2].
  double levels[2][4] = {};
  double moved_px2[4] = {};
};

// A left perturbation of T_camera_map and its motion. `slope`: factor of H in its equations.
struct CameraStep {
  double xi[6] = {};
  double R[9] = {};
  double t[3] = {};
  double fx = 0.0, fy = 0.0;
  double slope = 1.0;
};

// Normal equations of one tag in (nu, omega) of the right perturbation of T_camera_lattice [cells,
// rad], gain and offset. Residual: value - (gain * model + offset).
struct Sums {
  double H[36] = {};         // upper triangle of the 8x8 matrix, row by row
  double g[8] = {};          // J^T W r, with J = -d residual / d parameters
  double cost = 0.0;         // sum of w r^2
  double weight = 0.0;       // sum of w
  double base_weight = 0.0;  // sum of the samples' own weights
};

// The image, the pixels at each step along an edge, and the output.
struct WalkPlan {
  int width = 0, height = 0;       // of the image
  std::ptrdiff_t stride = 0;       // from an image row to the next [bytes]
  int most_rows = 0;               // pixels at a step
  int band_count = 0;              // 0: all within reach
  const float* offsets = nullptr;  // 0, 1, 2 ..., or the band's; 20 of them
  // Output: end of the samples and run of each step (Walk) or of each run with a step (RunWalk).
  std::int32_t* end = nullptr;
  std::int32_t* run = nullptr;
};

// Steps along the edges of one lattice direction, at pixel centres on the image axis that the edge
// is nearer to. Each takes the pixels across the edge within `reach_px`, or at a band's offsets.
struct Walk : WalkPlan {
  // Cells of all edges, concatenated: the point at distance d is at begin + d along the edge and at
  // `across`, by the record of cell floor(d). The last record is there twice.
  struct Cell {
    float begin = 0.0F, across = 0.0F;
    std::int32_t run = 0;  // index of the edge
  };
  const Cell* cells = nullptr;
  int cell_count = 0;
  int count = 0;                            // steps, evenly over all cells
  const float* ray_from_lattice = nullptr;  // 3 x 3, by rows
  bool along_b = false;                     // direction of the edges in the lattice
  bool along_x = false;                     // axis of the steps in the image
  float reach_px = 0.0F;                    // at right angles to the edge
  // A point at row y is displaced by shear (y - row), see AlignedTag::row_shear.
  float row = 0.0F, shear_x = 0.0F, shear_y = 0.0F;
};

// Edges of a tag, each walked along the image axis it is nearer to.
struct RunWalk : WalkPlan {
  struct Run {
    std::uint32_t begin = 0, end = 0;  // vertices
    bool vertical = false;             // in the lattice
  };
  // Sixteen runs, by measure_runs. "Along" is the axis of the walk, "across" the other one.
  struct Part {
    static constexpr int kRuns = 16;
    alignas(64) double length[kRuns];          // [px along]; -1: not to be walked
    double along_px[kRuns], across_px[kRuns];  // extent; 0 where the run is not seen
    double along[kRuns], across[kRuns];        // begin [px]
    double direction[kRuns], slope[kRuns];     // of the walk, 1 or -1, and across by along
    double reach[kRuns];                       // across [px]
    double ray_x[kRuns], ray_y[kRuns];         // at the begin
    double per_px_x[kRuns], per_px_y[kRuns];   // change of the ray per pixel along
    std::int32_t along_x[kRuns];               // 1: along is x
  };
  const Run* runs = nullptr;
  int count = 0;
  const float* ray_x = nullptr;  // of the vertices, as in Vertices
  const float* ray_y = nullptr;
  const float* pixel_x = nullptr;
  const float* pixel_y = nullptr;
  const float* depth = nullptr;
  Part* parts = nullptr;   // (count + 15) / 16
  double reach_px = 0.0;   // at right angles to the edge
  double stride_px = 0.0;  // along, from step to step; continues from run to run
  int walked = 0;          // output: number of runs with a step
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
  float centre[3] = {};  // of the camera in the lattice frame [cells]
  float gain = 0.0F, offset = 0.0F;
  float inverse_cutoff = 0.0F;  // of Tukey's weights [1 / grey]; 0: none
  int reach = 1;                // lines per axis: 1, 2 or 3
  bool correlated = false;      // whether rho is used
};

// The effect of a displacement of the edges on the residuals of the last accumulate.
struct LeverageInput {
  float inverse_gain = 0.0F;
  float offset = 0.0F;
  float inverse_limit = 0.0F;  // of Tukey's weights [1 / share of the gain]
};

struct Loops {
  const char* name;
  void (*project)(const Lens& lens, const Blur& blur, const float* ray_from_lattice,
                  const float* lattice_from_ray, const Vertices& vertices);
  // Writes pixels, guesses of rays and offsets in the image's memory (`vertex`) from sample `used`
  // on, and overwrites up to three samples more. Returns the end.
  int (*walk)(const Lens& lens, const Walk& walk, const Samples& samples, int used);
  // Fills `parts`; returns the sums of along_px and across_px.
  void (*measure_runs)(const RunWalk& walk, double& along_px, double& across_px);
  // As `walk`, from the first sample on.
  int (*walk_runs)(const Lens& lens, RunWalk& walk, const Samples& samples);
  // Reads the first `used` samples by `vertex` and a table of 256 levels, and pads to `count`.
  void (*read)(const std::uint8_t* pixels, const float* levels, int used, const Samples& samples);
  // Rays from guesses within a few pixels, and anchors on a lattice of side x side vertices.
  void (*prepare)(const Lens& lens, const float* lattice_from_ray, int reach, int side,
                  const Samples& samples);
  // ka, kb and c of the anchors with one line per axis, from those of all vertices.
  void (*attach)(const float* ka, const float* kb, const float* coefficients,
                 const Samples& samples);
  void (*accumulate)(const AccumulateInput& input, const Samples& samples, Sums& sums);
  // Anchors from the rays.
  void (*anchor)(const float* lattice_from_ray, int reach, int side, const Samples& samples);
  // Marginalises gains and offsets.
  void (*marginalise)(TagPack* packs, int count);
  // Applies a step to the tags.
  void (*follow)(const CameraStep& step, TagPack* packs, int count);
  // Writes moments[0].model: the mean over `count` moments with poses `inputs` and the same samples
  // with the anchors and the blur of each moment.
  void (*evaluate)(const AccumulateInput* inputs, const Samples* moments, int count);
  void (*leverage)(const LeverageInput& input, const Samples& samples);
  // scores[r * columns + c] = sum over the first `positive` points minus the sum over the others of
  // point[r * row_step * stride + c]; columns: 32 or 64.
  void (*search)(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
                 int count, int columns, int rows, int row_step, std::int16_t* scores);
  // sums[k] += scores[k]
  void (*add)(const std::int16_t* scores, int count, std::int32_t* sums);
  // For the cell above and right of each vertex of a lattice of side x side, which the last vertex
  // of a row and the last row do not have: memory offset of the pixel nearest to its centre, or
  // kNowhere.
  void (*cell_places)(int side, const CellCorners& corners, const ImagePlan& image,
                      std::int32_t* places);
};

[[nodiscard]] Lens lens_of(const CameraModel& camera);
// For the widest instruction set of this processor.
[[nodiscard]] const Loops& widest_loops();
// For all instruction sets of this processor, narrowest first; null ends the list.
[[nodiscard]] const Loops* const* available_loops();

}  // namespace penumbra::simd
