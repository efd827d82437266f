// The graph of a sweep: cameras and tags, chained from an anchor outwards, then adjusted together,
// and their covariance.
#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <map>
#include <optional>
#include <stop_token>
#include <utility>
#include <vector>

#include "calib/solver/corner_cost.hpp"
#include "calib/solver/packed_pose.hpp"
#include "calib/survey/tag_edges.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "tracking/detection/pose_solver.hpp"

namespace ceres {
class Problem;
}

namespace penumbra {

using TagPose = Transform<frame::Table, frame::Tag>;

struct TagSighting {
  int id = 0;
  double size_m = 0.0;
  std::array<Eigen::Vector2d, 4> corners_px;
  std::array<Eigen::Vector2d, 4> spread;      // edge_spreads(); zero for corrected corners
  Matrix8d whitening = Matrix8d::Identity();  // makes the corners' errors independent, of size 1
};

[[nodiscard]] TagSighting sighting_of(int id, double size_m,
                                      const std::array<Eigen::Vector2d, 4>& corners_px);
[[nodiscard]] TagSighting sighting_of(int id, double size_m, const MeasuredTag& measured);

// Covariance of the lens, then [position; rotation] of each tag but the anchor, by id, in the
// anchor's frame [m, rad].
struct GraphCovariance {
  Eigen::MatrixXd lens;  // empty for a fixed lens
  std::vector<int> ids;  // of the rows of `tags`, six each
  Eigen::MatrixXd tags;
  double clustering = 1.0;  // covariance inflation for correlated errors of neighbouring frames
};

// Pose and size of a tag, by all posed frames that show it.
struct TagPlacement {
  TagPose T_anchor_tag;
  double scale = 1.0;  // its size over the nominal one
  // Each frame that shows it, with the RMS error of its corners.
  std::vector<std::pair<std::size_t, double>> errors_px;

  // Each error counts as at most kFarOff.
  [[nodiscard]] double mean_px() const;
  [[nodiscard]] double median_px() const;
};
inline constexpr double kFarOff = 20.0;  // [px]

class TagGraph {
 public:
  static constexpr std::size_t kAllFrames = std::numeric_limits<std::size_t>::max();
  TagGraph(const CameraModel& camera, int anchor);

  std::vector<std::vector<TagSighting>> frames;
  std::map<int, Pose6> tags;                  // placed ones: T_anchor_tag
  std::vector<std::optional<Pose6>> cameras;  // T_camera_anchor, as `frames`
  double shift = 0.0;  // outward, of edges that were not measured one by one [px]
  bool shift_is_free = true;
  bool lens_is_free = false;
  std::stop_token stop;  // once requested, everything ends soon without a usable result

  // The given or solved lens. Fails if the solved parameters are not valid.
  [[nodiscard]] Result<CameraModel> camera() const;
  // Poses cameras by placed tags. A frame with two nearly equal poses gets none.
  void pose_cameras();
  // A frame that is posed, with the tag in it.
  using Seen = std::pair<std::size_t, const TagSighting*>;
  [[nodiscard]] std::vector<Seen> seen_of(int id, std::size_t first = 0,
                                          std::size_t last = kAllFrames) const;
  // The pose, from one of the posed frames of `first` to `last` (half open), that explains most of
  // them best; nothing for fewer than two. The size is `scale` times the nominal one.
  [[nodiscard]] std::optional<TagPlacement> place(int id, double scale = 1.0, std::size_t first = 0,
                                                  std::size_t last = kAllFrames) const;
  // Least squares over all of these frames, with fixed cameras and, if asked, a free size.
  [[nodiscard]] std::optional<TagPlacement> fit(int id, bool free_size, std::size_t first = 0,
                                                std::size_t last = kAllFrames) const;
  // Recomputes the errors of `fit` over all posed frames.
  void measure(TagPlacement& fit, int id) const;
  // Bundle adjustment; false if it fails.
  bool adjust(bool robust);
  // Removes outlier sightings; true if there were any. `rms_px`: 2-D distance of the rest.
  bool drop_outliers(double& rms_px);
  [[nodiscard]] Result<GraphCovariance> covariance();

 private:
  void measure(TagPlacement& fit, const std::vector<Seen>& seen, const CameraModel& camera) const;
  [[nodiscard]] std::vector<PointObservation> placed_in(std::size_t frame) const;
  template <class Visit>
  void for_each(const Visit& visit);
  void build(ceres::Problem& problem, bool robust);

  CameraModel start_;
  int anchor_;
  LensParameters lens_;
};

}  // namespace penumbra
