// State of an alignment: camera, tags, image, and the tags' projection at the current pose.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/image/image_view.hpp"
#include "tracking/alignment/aligned_tag.hpp"
#include "tracking/alignment/simd/alignment_loops.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {

// floor and ceil for |x| < 2^20, without a library call.
inline int floor_of(double x) {
  constexpr int kShift = 1 << 20;
  return static_cast<int>(x + kShift) - kShift;
}
inline int ceil_of(double x) {
  return -floor_of(-x);
}

// Returns the matrix in row order, for the SIMD loops.
[[nodiscard]] std::array<float, 9> rows_of(const Eigen::Matrix3d& matrix);

// Selects what is projected.
enum class Projection {
  search,  // search cells
  wide,    // lattice with the blur of the wide stage
  fine,    // lattice with the blur of the image
};

enum class BlurModel {
  point_spread,  // one Gaussian point spread per tag
  moments,       // mean over several moments of the exposure
};

using Vector12d = Eigen::Matrix<double, 12, 1>;
using Matrix12d = Eigen::Matrix<double, 12, 12>;

// Prior of [xi; w]: left perturbation of T_camera_map at the time of the middle row, and its rate
// [m/s, rad/s]. See docs/tracking.md#rolling-shutter.
struct MotionPrior {
  Vector6d velocity;      // as AlignmentInput::velocity, which is -w
  Matrix12d information;  // of [xi; w]
};

struct AlignmentProblem {
  // Fails if a tag's id does not exist in its family.
  [[nodiscard]] static Result<AlignmentProblem> make(const CameraModel& camera,
                                                     std::span<const MappedTag> tags,
                                                     const AlignmentOptions& options);

  CameraModel camera;
  AlignmentOptions options;
  const simd::Loops* loops = nullptr;
  simd::Lens lens;
  std::array<float, 256> tone{};  // grey level to linear light
  std::vector<AlignedTag> tags;

  // State of the current frame.
  ImageView image;
  Eigen::Isometry3d T_camera_map = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_predicted = Eigen::Isometry3d::Identity();  // T_camera_map as predicted
  // Covariance of the prediction as a left perturbation of T_camera_map, and its inverse.
  Matrix6d prior_covariance = Matrix6d::Zero();
  Matrix6d prior_information = Matrix6d::Zero();
  double row_s = 0.0;                           // time from one row to the next
  Vector6d row_velocity = Vector6d::Zero();     // camera motion per row [m, rad]
  std::optional<MotionPrior> motion_prior;      // if the velocity is solved for
  Vector6d exposure_motion = Vector6d::Zero();  // camera motion during the exposure [m, rad]
  std::vector<AlignedTag*> active;              // usable tags; see find_visible()
  double moved_since_projection_px = 0.0;       // maximum over the tag corners
  AlignmentCounters counters;

  void set_tone(double exponent);
  void begin(const AlignmentInput& input);
  void set_exposure_motion(const Vector6d& motion);
  // Returns to the prediction.
  void reset_motion();
  // Requires motion_prior.
  [[nodiscard]] Vector6d velocity() const { return row_velocity / row_s; }
  // Returns the time from the middle row's exposure to that of the tag's row.
  [[nodiscard]] double read_time_s(const AlignedTag& tag) const {
    return row_s * (tag.row - 0.5 * (camera.height() - 1));
  }
  // Moves the tag to its pose at the time of its row, after a change of row_velocity.
  void set_row_motion(AlignedTag& tag) const;
  // Sets the matrix that maps the rate of T_camera_map to the left perturbation of the tag: the
  // displacement until its row is read, and the motion that resembles its shear most.
  void find_motion_by_velocity(AlignedTag& tag) const;
  // Returns the tag's displacement per row [px] at the current pose and velocity.
  [[nodiscard]] Eigen::Vector2d shear_of(const AlignedTag& tag) const;
  [[nodiscard]] MapFromCamera pose() const;
  [[nodiscard]] int index_of(const AlignedTag& tag) const {
    return static_cast<int>(&tag - tags.data());
  }
  [[nodiscard]] double smallest_cell_px() const;

  // Sets `active` to the tags that are usable at the current pose, and projects them.
  void find_visible(Projection projection);
  // Sets the tag's transforms for the current pose.
  void place(AlignedTag& tag) const;
  // Sets the tag's size and motion in the image; returns true if it is usable at the current pose.
  [[nodiscard]] bool measure(AlignedTag& tag, BlurModel blur = BlurModel::point_spread) const;
  // Sets the poses of a tag at the moments of the exposure.
  void place_moments(AlignedTag& tag);
  // Projects the tag's vertices. `added_variance_px2`: variance of the model's additional blur.
  void project_lattice(AlignedTag& tag, double added_variance_px2) const;
  // Sets the pixel nearest to a cell's centre; returns false if it is outside the image.
  [[nodiscard]] bool nearest_cell_pixel(const AlignedTag& tag, const DataCell& cell, int& x,
                                        int& y) const {
    const auto v = static_cast<std::size_t>(cell.j * tag.side + cell.i);
    const std::size_t up = v + static_cast<std::size_t>(tag.side);
    if (!tag.fully_projected && !(tag.depth[v] > 0.0F && tag.depth[v + 1] > 0.0F &&
                                  tag.depth[up] > 0.0F && tag.depth[up + 1] > 0.0F))
      return false;
    const float* px = tag.pixel_x.data();
    const float* py = tag.pixel_y.data();
    const double centre_x = 0.25 * static_cast<double>(px[v] + px[v + 1] + px[up] + px[up + 1]);
    const double centre_y = 0.25 * static_cast<double>(py[v] + py[v + 1] + py[up] + py[up + 1]);
    if (!(std::abs(centre_x) < 1e5 && std::abs(centre_y) < 1e5)) return false;
    x = floor_of(centre_x + 0.5);
    y = floor_of(centre_y + 0.5);
    return x >= 0 && y >= 0 && x < image.width && y < image.height;
  }
  // Returns, for cell (i, j) at index j * side + i, the memory offset of the pixel nearest to its
  // centre, or simd::kNowhere. Valid until the next call.
  [[nodiscard]] const std::int32_t* find_cell_pixels(const AlignedTag& tag);

 private:
  void set_motion_prior(const AlignmentInput& input);
  void find_row_motion(AlignedTag& tag) const;
  void project(AlignedTag& tag, double added_variance_px2, simd::Vertices& vertices) const;
  void project_search(AlignedTag& tag) const;
  void measure_motion(AlignedTag& tag, const Eigen::Vector3d& centre,
                      const Eigen::Matrix<double, 2, 3>& J, BlurModel blur) const;

  static constexpr int kMaxMoments = 16;
  // paths_[n]: camera motion from T_camera_map to each of n moments; computed when needed.
  std::array<std::vector<Eigen::Isometry3d>, kMaxMoments + 1> paths_;
  std::vector<std::int32_t> cell_pixels_;
};

}  // namespace penumbra
