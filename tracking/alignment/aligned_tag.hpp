// A tag in an alignment: its printed pattern on a lattice, the lattice's projection, and the
// samples (pixels) that are compared with it.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "tracking/alignment/simd/alignment_loops.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {

// Maximum number of cells per tag in the pattern search, such that their sums fit in 16 bits.
inline constexpr int kMaxSearchCells = 36;
// Minimum number of samples for a tag to contribute equations.
inline constexpr int kMinSamples = 16;
// A tag is used only if the mean Tukey weight of its samples is at least this.
inline constexpr double kMinWeightFraction = 0.3;

struct AlignedTag {
  // Fails if the family has no such id.
  [[nodiscard]] static Result<AlignedTag> make(const MappedTag& mapped);

  TagPattern pattern;
  Eigen::Isometry3d T_map_tag = Eigen::Isometry3d::Identity();
  double cell_m = 0.0;
  // The paper's height over the lattice [cells]: c[0] + (c[1] a^2 + 2 c[2] a b + c[3] b^2) / 2,
  // with a and b from the tag's centre; all zero for flat paper.
  std::array<float, 4> height{};
  bool is_curved = false;
  int side = 0;  // lattice vertices per side
  // Lattice coordinates of the vertices; padded to a multiple of 16 with copies of the last vertex.
  std::vector<float> lattice_a, lattice_b;
  // Coefficients of each vertex for 1, 2 and 3 lines per axis; see simd::Samples.
  std::vector<std::array<float, 4>> coefficients1;
  std::vector<std::array<float, 16>> coefficients2, coefficients3;
  std::vector<simd::RunWalk::Run> runs;  // edges of the pattern
  // Cells of the runs along a, and of those along b; see simd::Walk.
  std::array<std::vector<simd::Walk::Cell>, 2> edge_cells;
  std::vector<DataCell> search_cells;  // equal numbers of white and black cells, white first
  int search_white = 0;                // number of white search cells
  // Search points: centres of the search cells, then the lattice's corners; padded with the last.
  std::vector<float> search_a, search_b;

  // State of the current frame. AlignmentProblem::begin() sets only `rejected`. find_visible() and
  // the stages set the other members, but only of tags that are not rejected: rejected tags keep
  // values of an earlier frame.
  bool rejected = false;  // ignored in this frame
  bool visible = false;
  bool too_small = false;        // reason for not being visible
  bool fully_projected = false;  // all vertices have a projection
  Eigen::Matrix3d R_lattice_camera = Eigen::Matrix3d::Identity();
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // camera centre, lattice frame [cells]
  Eigen::Matrix3d ray_from_lattice = Eigen::Matrix3d::Identity();  // (a, b, 1) to the camera frame
  std::array<float, 9> lattice_from_ray{};
  std::vector<float> ray_x, ray_y, pixel_x, pixel_y, depth, ka, kb, rho;  // see simd::Vertices
  // Search points; depth <= 0 if the point has no projection.
  std::vector<float> search_x, search_y, search_depth;
  Eigen::Vector2d along_a = Eigen::Vector2d::Zero();  // a cell's sides at the tag's centre [px]
  Eigen::Vector2d along_b = Eigen::Vector2d::Zero();
  double cell_px = 0.0;      // smaller width of the central cell
  double cell_max_px = 0.0;  // larger width of the central cell
  double correlation = 0.0;  // correlation of the point spread along a and b
  // Camera motion while a rolling shutter reads from the image's middle row to `row`.
  Eigen::Isometry3d row_motion = Eigen::Isometry3d::Identity();
  double row = 0.0;                                     // image row of the tag's centre
  Eigen::Vector2d row_shear = Eigen::Vector2d::Zero();  // the tag's displacement per row [px]
  // The tag's motion by the rate of T_camera_map; see AlignmentProblem::find_motion_by_velocity().
  Eigen::Matrix<double, 6, 6> motion_by_velocity = Eigen::Matrix<double, 6, 6>::Zero();
  Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();  // the tag's motion during the exposure
  int moments = 1;  // number of equally spaced moments that model the exposure
  Eigen::Vector2d spread_px = Eigen::Vector2d::Zero();  // the tag's motion within one moment
  // Sigma of the point spread along a and b, including spread_px.
  Eigen::Vector2d sigma_cells = Eigen::Vector2d::Zero();
  double gain = 0.0, offset = 0.0;   // linear light = gain * pattern + offset
  int reach = 1;                     // number of pattern lines per axis that affect a pixel
  bool correlated = false;           // the model uses `correlation`
  simd::Samples samples;             // memory in the arena
  std::vector<std::int32_t> vertex;  // memory of samples.vertex
  // Samples and poses of each moment, if there are several.
  std::vector<simd::Samples> moment_samples;
  std::vector<simd::AccumulateInput> moment_inputs;
  int capacity = 0;                    // [samples]
  int used = 0;                        // number of samples without padding
  int step_count = 0;                  // steps or runs of the latest selection
  bool thinned = false;                // pixels at edges were skipped
  std::vector<std::int32_t> step_end;  // end of each step's samples
  std::vector<std::int32_t> step_run;
  simd::Sums sums;
  std::vector<std::int16_t> scores;  // score map of the pattern search
  int score_points = 0;              // number of cells in `scores`

  // Returns a lattice point in the camera frame.
  [[nodiscard]] Eigen::Vector3d point(double a, double b) const {
    return ray_from_lattice * Eigen::Vector3d(a, b, 1.0);
  }
  [[nodiscard]] Eigen::Vector3d centre_point() const {
    const double half = 0.5 * (side - 1);
    return point(half, half);
  }
};

}  // namespace penumbra
