// Pose graph of a sweep: cameras and tags are chained outwards from an anchor, then bundle
// adjusted. Also computes the covariance of the tags and the lens.
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
  std::array<Eigen::Vector2d, 4> spread;      // d corner / d edge shift; 0 for a MeasuredTag
  Matrix8d whitening = Matrix8d::Identity();  // makes the corners' errors independent, sigma 1
};

[[nodiscard]] TagSighting sighting_of(int id, double size_m,
                                      const std::array<Eigen::Vector2d, 4>& corners_px);
[[nodiscard]] TagSighting sighting_of(int id, double size_m, const MeasuredTag& measured);

// Covariances of the lens and of [position; rotation] of each tag except the anchor, by id, in the
// anchor's frame [m, rad].
struct GraphCovariance {
  Eigen::MatrixXd lens;  // empty for a fixed lens
  std::vector<int> ids;  // tag ids; each has six rows in `tags`
  Eigen::MatrixXd tags;
  double covariance_inflation = 1.0;  // factor for correlated errors of neighbouring frames
  // For a free lens: sigma of a whitened residual that accounts for all errors of the lens.
  double lens_noise = 1.0;
};

// Pose and size of a tag, estimated from all posed frames that show it.
struct TagPlacement {
  TagPose T_anchor_tag;
  double scale = 1.0;  // true size / nominal size
  // For each frame that shows the tag: frame index and RMS error of the corners.
  std::vector<std::pair<std::size_t, double>> errors_px;

  // Returns the mean, with each error limited to kMaxSightingError_px.
  [[nodiscard]] double mean_px() const;
  [[nodiscard]] double median_px() const;
};
inline constexpr double kMaxSightingError_px = 20.0;

class TagGraph {
 public:
  static constexpr std::size_t kAllFrames = std::numeric_limits<std::size_t>::max();
  TagGraph(const CameraModel& camera, int anchor);

  std::vector<std::vector<TagSighting>> frames;
  std::map<int, Pose6> tags;                  // T_anchor_tag of placed tags
  std::vector<std::optional<Pose6>> cameras;  // T_camera_anchor of each frame
  double shift = 0.0;                         // outward edge shift of tags without MeasuredTag [px]
  bool shift_is_free = true;
  // Covariance of the prior of the lens, whose mean is the given lens; empty: the lens is fixed.
  Eigen::MatrixXd lens_prior;
  double prior_noise = 1.0;  // sigma of a whitened residual; weighs the prior
  std::stop_token stop;      // once requested, all functions end soon without a usable result

  // Returns the given or solved lens. Fails if the solved parameters are not valid.
  [[nodiscard]] Result<CameraModel> camera() const;
  // Estimates camera poses from placed tags; skips frames with two poses that fit almost equally.
  void pose_cameras();
  // A posed frame and its sighting of the tag.
  using PosedSighting = std::pair<std::size_t, const TagSighting*>;
  [[nodiscard]] std::vector<PosedSighting> sightings_of(int id, std::size_t first = 0,
                                                        std::size_t last = kAllFrames) const;
  // Estimates a pose from each of up to 19 posed frames in [first, last). Returns the pose with the
  // least median error in this range; nullopt below two frames. `scale`: true / nominal size.
  [[nodiscard]] std::optional<TagPlacement> place(int id, double scale = 1.0, std::size_t first = 0,
                                                  std::size_t last = kAllFrames) const;
  // Fits the pose, and the size if it is free, to the posed frames in [first, last).
  [[nodiscard]] std::optional<TagPlacement> fit(int id, bool free_size, std::size_t first = 0,
                                                std::size_t last = kAllFrames) const;
  // Recomputes the errors of `fit` over all posed frames.
  void measure(TagPlacement& fit, int id) const;
  // Bundle adjustment; returns false if it fails.
  bool adjust(bool robust);
  // Removes outlier sightings; returns true if there were any. `rms_px`: 2-D error of kept corners.
  bool drop_outliers(double& rms_px);
  [[nodiscard]] Result<GraphCovariance> covariance() const;
  // Returns a copy that has the given lens, with another prior.
  [[nodiscard]] TagGraph with_lens_prior(const Eigen::MatrixXd& prior) const;
  // Fits the cameras alone; returns the sum of squared whitened residuals, or nullopt if it fails.
  [[nodiscard]] std::optional<double> fit_cameras();

 private:
  void measure(TagPlacement& fit, const std::vector<PosedSighting>& seen,
               const CameraModel& camera) const;
  [[nodiscard]] std::vector<PointObservation> placed_in(std::size_t frame) const;
  template <class Visit>
  void for_each(const Visit& visit);
  void build(ceres::Problem& problem, bool robust);
  void add_lens_prior(ceres::Problem& problem);
  // Returns the final cost, or nullopt if it fails.
  [[nodiscard]] std::optional<double> solve(ceres::Problem& problem);

  CameraModel start_;
  int anchor_;
  LensParameters lens_;
};

}  // namespace penumbra
