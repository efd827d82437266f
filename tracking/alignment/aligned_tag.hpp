// A tag in an alignment: its printed pattern on a lattice, the lattice's projection, and the pixels
// that are compared with it.
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

// Most cells of a tag in the pattern search: sums of this number of bytes fit in 16 bits.
inline constexpr int kMaxSearchCells = 36;
// Fewest samples for a tag to have equations.
inline constexpr int kFewestSamples = 16;
// Least share of its samples' weight, after Tukey's weights, for a tag to count.
inline constexpr double kLeastWeightShare = 0.3;

struct AlignedTag {
  // Fails when the family has no such id.
  [[nodiscard]] static Result<AlignedTag> make(const MappedTag& mapped);

  TagPattern pattern;
  Eigen::Isometry3d T_map_tag = Eigen::Isometry3d::Identity();
  double cell_m = 0.0;
  int side = 0;  // lattice vertices per side
  // Vertices, padded with the last one to a multiple of 16.
  std::vector<float> lattice_a, lattice_b;
  // Coefficients of each vertex for 1, 2 and 3 lines per axis, see simd::Samples.
  std::vector<std::array<float, 4>> coefficients1;
  std::vector<std::array<float, 16>> coefficients2, coefficients3;
  std::vector<simd::RunWalk::Run> runs;  // the pattern's
  // Cells of the runs along a, and along b, see simd::Walk.
  std::array<std::vector<simd::Walk::Cell>, 2> edge_cells;
  std::vector<DataCell> search_cells;  // as many white as black, the white ones first
  int search_white = 0;
  // Centres of the search cells in the lattice, then its four corners; padded with the last one.
  std::vector<float> search_a, search_b;

  // The current frame. AlignmentProblem::begin() sets `rejected` only. find_visible() and the
  // stages write the rest, of tags that are not rejected; the others keep values of an earlier
  // frame.
  bool rejected = false;  // not looked at
  bool visible = false;
  bool too_small = false;    // if not visible
  bool wholly_seen = false;  // all vertices have a projection
  Eigen::Matrix3d R_lattice_camera = Eigen::Matrix3d::Identity();
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of the camera in the lattice [cells]
  Eigen::Matrix3d ray_from_lattice = Eigen::Matrix3d::Identity();
  std::array<float, 9> lattice_from_ray{};
  std::vector<float> ray_x, ray_y, pixel_x, pixel_y, depth, ka, kb, rho;  // of the vertices
  // Search points; depth is not positive where there is no projection.
  std::vector<float> search_x, search_y, search_depth;
  Eigen::Vector2d along_a = Eigen::Vector2d::Zero();  // a cell's sides at the tag's centre [px]
  Eigen::Vector2d along_b = Eigen::Vector2d::Zero();
  double cell_px = 0.0;  // smaller and larger width of the central cell
  double cell_max_px = 0.0;
  double correlation = 0.0;
  // Rolling shutter: motion of the camera from the image's middle row to the row through the tag's
  // centre, that row, and the displacement of the tag from row to row [px].
  Eigen::Isometry3d row_motion = Eigen::Isometry3d::Identity();
  double row = 0.0;
  Eigen::Vector2d row_shear = Eigen::Vector2d::Zero();
  Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();  // during the exposure
  // Moments of the exposure, motion within each, and sigma of the point spread with that.
  int moments = 1;
  Eigen::Vector2d spread_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d sigma_cells = Eigen::Vector2d::Zero();
  double gain = 0.0, offset = 0.0;
  int reach = 1;  // lines per axis in the model of a pixel
  bool correlated = false;
  simd::Samples samples;             // in the arena
  std::vector<std::int32_t> vertex;  // memory of samples.vertex
  // Samples and poses of each moment, where there are several.
  std::vector<simd::Samples> moment_samples;
  std::vector<simd::AccumulateInput> moment_inputs;
  int capacity = 0;  // [samples]
  int used = 0;      // samples without padding
  // Steps or runs of the last selection, with the end of their samples.
  int step_count = 0;
  bool thinned = false;  // not every pixel at an edge was taken
  std::vector<std::int32_t> step_end, step_run;
  simd::Sums sums;
  std::vector<std::int16_t> scores;  // of the pattern search
  int score_points = 0;

  // In the camera frame.
  [[nodiscard]] Eigen::Vector3d point(double a, double b) const {
    return ray_from_lattice * Eigen::Vector3d(a, b, 1.0);
  }
  [[nodiscard]] Eigen::Vector3d centre_point() const {
    const double half = 0.5 * (side - 1);
    return point(half, half);
  }
};

}  // namespace penumbra
