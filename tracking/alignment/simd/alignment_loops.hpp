// Inner loops of the pattern alignment, compiled for each instruction set and selected at run time.
// Every instruction set gives the same bits: sums use 16 fixed lanes and no fused multiply-add.
// Data are plain arrays of float, because code for a wider instruction set must not instantiate
// templates that other files share.
//
// Lattice coordinates (a, b): see tag_pattern.hpp. A ray is (x, y) of the undistorted direction (x,
// y, 1) in the camera frame.
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
  // Squared radius of rays beyond which the distortion is non-monotonic; may be infinite.
  float max_radius2 = __builtin_inff();
};

// Blur variance of lens and pixel box, and motion during the exposure.
struct Blur {
  float variance_px2 = 0.0F;
  float motion_x_px = 0.0F, motion_y_px = 0.0F;
};

// Lattice points and their projection. If the outputs are not needed, rho is null, or the rays, ka,
// kb and rho are null.
struct Vertices {
  int count = 0;  // multiple of 16
  const float* a = nullptr;
  const float* b = nullptr;
  float* ray_x = nullptr;
  float* ray_y = nullptr;
  float* pixel_x = nullptr;
  float* pixel_y = nullptr;
  float* depth = nullptr;  // <= 0: behind the camera or beyond the lens model
  float* ka = nullptr;     // 1 / sigma of the blur along a [1/cells]
  float* kb = nullptr;     // 1 / sigma of the blur along b [1/cells]
  float* rho = nullptr;    // correlation of the blur along a and b
};

// Samples of one tag. Each has an anchor: the lattice vertex (va, vb) nearest to the pixel, or,
// with two lines per axis, below and left of it. `c`: coefficients of the anchor, see pattern() in
// residuals_body.hpp.
struct Samples {
  int count = 0;  // multiple of kBlock; padding has weight 0
  float* pixel_x = nullptr;
  float* pixel_y = nullptr;
  float* ray_x = nullptr;
  float* ray_y = nullptr;
  float* value = nullptr;
  float* weight = nullptr;
  std::int32_t* vertex = nullptr;  // index of the anchor: vb * side + va
  float* va = nullptr;
  float* vb = nullptr;
  float* ka = nullptr;
  float* kb = nullptr;
  float* rho = nullptr;
  float* c[16] = {};
  float* model = nullptr;     // output of evaluate: the pattern's blurred value, 0 black to 1 white
  float* residual = nullptr;  // output of accumulate
  // Output of leverage: pairs leverage * residual, leverage * slope; then `count` leverage^2.
  float* leverage = nullptr;
};

// Four tags in a step, selected by the final index. Matrices are in row order.
struct TagPack {
  double H[36][4] = {};  // from Sums; zero for a tag without equations
  double g[8][4] = {};
  double weight[4] = {};
  double R[9][4] = {};  // lattice from camera
  double centre[3][4] = {};
  double per_cell[4] = {};             // [1/m]
  double ray_from_lattice[9][4] = {};  // transform at the tag's pose before the step
  double side_cells[4] = {};
  // Output of marginalise.
  bool valid[4] = {};
  double inverse[3][4] = {};  // inverse of the equations of gain and offset; upper triangle
  // Marginalised H of the camera's motion: blocks nu nu (6 numbers), nu omega (9), omega omega (6).
  double H_camera[21][4] = {};
  double g_camera[6][4] = {};  // marginalised gradient
  // Output of follow.
  double levels[2][4] = {};  // changes of gain and offset
  double moved_px2[4] = {};  // maximum squared motion of a corner [px^2]
};

// A step of the pose as a left perturbation of T_camera_map.
struct CameraStep {
  double xi[6] = {};  // [nu; omega] [m, rad]
  double R[9] = {};   // rotation of exp(xi), by rows
  double t[3] = {};   // translation of exp(xi)
  double fx = 0.0, fy = 0.0;
  double slope = 1.0;  // see PoseSolver::slope()
};

// Normal equations of one tag in (nu, omega) of the right perturbation of T_camera_lattice [cells,
// rad], gain and offset. Residual: value - (gain * model + offset).
struct Sums {
  double H[36] = {};         // upper triangle of the 8x8 matrix, row by row
  double g[8] = {};          // J^T W r, with J = -d residual / d parameters
  double cost = 0.0;         // sum of w r^2
  double weight = 0.0;       // sum of w
  double base_weight = 0.0;  // sum of the samples' prior weights
};

// Common input and output of Walk and RunWalk.
struct WalkPlan {
  int width = 0, height = 0;       // image size [px]
  std::ptrdiff_t stride = 0;       // distance between image rows [bytes]
  int max_rows = 0;                // maximum pixels per step
  int band_count = 0;              // number of `offsets`; 0: all pixels within reach
  const float* offsets = nullptr;  // 20 offsets: 0, 1, 2 ..., or those of the band
  // Output for each step (Walk) or each run with a step (RunWalk): end of its samples, and its run.
  std::int32_t* end = nullptr;
  std::int32_t* run = nullptr;
};

// Steps along the edges of one lattice direction, at pixel centres on the image axis nearer to the
// edge. Each step samples the pixels across the edge within `reach_px`, or at a band's offsets.
struct Walk : WalkPlan {
  // Cells of all edges, concatenated: the point at distance d is in cell k = floor(d), at
  // cells[k].begin + d along the edge and cells[k].across across it. The final record is repeated.
  struct Cell {
    float begin = 0.0F, across = 0.0F;
    std::int32_t run = 0;  // index of the edge
  };
  const Cell* cells = nullptr;
  int cell_count = 0;
  int count = 0;                            // number of steps, evenly spaced over all cells
  const float* ray_from_lattice = nullptr;  // 3 x 3, by rows
  bool along_b = false;                     // direction of the edges in the lattice
  bool along_x = false;                     // axis of the steps in the image
  float reach_px = 0.0F;                    // at right angles to the edge
  // A point at row y is displaced by shear (y - row); see AlignedTag::row_shear.
  float row = 0.0F, shear_x = 0.0F, shear_y = 0.0F;
};

// Edges of a tag, each walked along the nearer image axis.
struct RunWalk : WalkPlan {
  struct Run {
    std::uint32_t begin = 0, end = 0;  // vertices
    bool vertical = false;             // in the lattice
  };
  // Output of measure_runs: 16 runs. "Along" is the image axis of the walk, "across" the other.
  struct Part {
    static constexpr int kRuns = 16;
    alignas(64) double length[kRuns];          // [px along]; -1: skip
    double along_px[kRuns], across_px[kRuns];  // extent; 0 if the run is not visible
    double along[kRuns], across[kRuns];        // begin [px]
    double direction[kRuns], slope[kRuns];     // 1 or -1: sign of the walk; d across / d along
    double reach[kRuns];                       // maximum distance across [px]
    double ray_x[kRuns], ray_y[kRuns];         // ray at the begin
    double per_px_x[kRuns], per_px_y[kRuns];   // d ray / d pixel along
    std::int32_t along_x[kRuns];               // 1: along is x
  };
  const Run* runs = nullptr;
  int count = 0;
  const float* ray_x = nullptr;  // arrays over the vertices, as in Vertices
  const float* ray_y = nullptr;
  const float* pixel_x = nullptr;
  const float* pixel_y = nullptr;
  const float* depth = nullptr;
  Part* parts = nullptr;   // (count + 15) / 16
  double reach_px = 0.0;   // at right angles to the edge
  double stride_px = 0.0;  // step length along; continues over runs
  int walked = 0;          // output: number of runs with a step
};

inline constexpr std::int32_t kNowhere = INT32_MIN;  // offset of a cell outside the image

struct CellCorners {  // projected vertices; see Vertices
  const float* pixel_x = nullptr;
  const float* pixel_y = nullptr;
  const float* depth = nullptr;
};

struct ImagePlan {
  int width = 0, height = 0;
  std::ptrdiff_t stride = 0;  // distance between rows [bytes]
};

struct AccumulateInput {
  float lattice_from_ray[9] = {};
  float centre[3] = {};  // camera in the lattice frame [cells]
  float gain = 0.0F, offset = 0.0F;
  float inverse_cutoff = 0.0F;  // 1 / cutoff of Tukey's weights [1 / grey]; 0: least squares
  int reach = 1;                // lines per axis: 1, 2 or 3
  bool correlated = false;      // whether rho is used
};

// Input of Loops::leverage: how a displacement of the edges changes the latest residuals.
struct LeverageInput {
  float inverse_gain = 0.0F;
  float offset = 0.0F;
  float inverse_limit = 0.0F;  // 1 / cutoff of Tukey's weights [1 / fraction of the gain]
};

// Curved paper over a tag's lattice; see docs/tracking.md#the-stages.
struct CurvedPaper {
  // Height [cells]: c[0] + (c[1] a^2 + 2 c[2] a b + c[3] b^2) / 2, with a and b from the tag's
  // centre.
  float height[4] = {};
  float half = 0.0F;     // lattice coordinate of the tag's centre
  float camera[3] = {};  // camera centre, lattice frame [cells]
  float ray_from_lattice[9] = {};
  float lattice_from_ray[9] = {};
};

struct Loops {
  const char* name;
  void (*project)(const Lens& lens, const Blur& blur, const float* ray_from_lattice,
                  const float* lattice_from_ray, const Vertices& vertices);
  // Writes pixels, initial rays and memory offsets (in `vertex`) of samples from index `used`. May
  // overwrite three samples beyond the end, which it returns.
  int (*walk)(const Lens& lens, const Walk& walk, const Samples& samples, int used);
  // Fills `parts`; returns the sums of along_px and across_px.
  void (*measure_runs)(const RunWalk& walk, double& along_px, double& across_px);
  // Like `walk`, from the first sample.
  int (*walk_runs)(const Lens& lens, RunWalk& walk, const Samples& samples);
  // Looks up the pixels at the first `used` samples' memory offsets (in `vertex`) in a table of 256
  // levels; pads to `count`.
  void (*read)(const std::uint8_t* pixels, const float* levels, int used, const Samples& samples);
  // Refines rays that are off by a few pixels; sets anchors on a lattice of side x side vertices.
  void (*prepare)(const Lens& lens, const float* lattice_from_ray, int reach, int side,
                  const Samples& samples);
  // Gathers ka, kb and c of the anchors from those of all vertices, for one line per axis.
  void (*attach)(const float* ka, const float* kb, const float* coefficients,
                 const Samples& samples);
  void (*accumulate)(const AccumulateInput& input, const Samples& samples, Sums& sums);
  // Recomputes the anchors from the rays.
  void (*anchor)(const float* lattice_from_ray, int reach, int side, const Samples& samples);
  // Replaces rays to curved paper by rays to the same points of the flat pattern; sets the anchors.
  void (*flatten)(const CurvedPaper& paper, int reach, int side, const Samples& samples);
  void (*marginalise)(TagPack* packs, int count);
  // Computes the changes of the tags by a step.
  void (*follow)(const CameraStep& step, TagPack* packs, int count);
  // Writes moments[0].model: the mean over `count` moments with poses `inputs`. The moments have
  // the same samples, but their own anchors and blur.
  void (*evaluate)(const AccumulateInput* inputs, const Samples* moments, int count);
  void (*leverage)(const LeverageInput& input, const Samples& samples);
  // scores[r * columns + c] = sum of point[r * row_step * stride + c] over the first `positive`
  // points, minus the sum over the others; columns: 32 or 64.
  void (*search)(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
                 int count, int columns, int rows, int row_step, std::int16_t* scores);
  // sums[k] += scores[k]
  void (*add)(const std::int16_t* scores, int count, std::int32_t* sums);
  // Finds, for the cell above and right of each vertex of a side x side lattice, the memory offset
  // of the pixel nearest to its centre, or kNowhere. The final row and column have no cells.
  void (*cell_pixels)(int side, const CellCorners& corners, const ImagePlan& image,
                      std::int32_t* places);
};

[[nodiscard]] Lens lens_of(const CameraModel& camera);
// Returns the loops for the widest instruction set of this processor.
[[nodiscard]] const Loops& widest_loops();
// Returns a null-terminated list for all instruction sets of this processor, narrowest first.
[[nodiscard]] const Loops* const* available_loops();

}  // namespace penumbra::simd
