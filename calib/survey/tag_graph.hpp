// The graph of a sweep: cameras and tags, chained from an anchor outwards, then adjusted all
// together, and what the result is worth.
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
  // Where the corners move to for each pixel by which the tag's edges lie further out; zero where
  // that is taken out of them already.
  std::array<Eigen::Vector2d, 4> spread;
  Matrix8d whitening = Matrix8d::Identity();  // makes the corners' errors of one size, near 1
};

[[nodiscard]] TagSighting sighting_of(int id, double size_m,
                                      const std::array<Eigen::Vector2d, 4>& corners_px);
[[nodiscard]] TagSighting sighting_of(int id, double size_m, const MeasuredTag& measured);

// Small motions of everything that was solved for, in this order: lens, then [position; turn] of
// each tag but the anchor, by id, in the anchor's frame [m, rad].
struct GraphCovariance {
  Eigen::MatrixXd lens;  // empty where the lens is given
  std::vector<int> ids;  // of the rows of `tags`, six each
  Eigen::MatrixXd tags;
  double noise = 0.0;       // of whitened residuals: 1 where the corners are as good as they say
  double clustering = 1.0;  // by which the covariance was raised: errors of one frame, and of those
                            // next to it, hang together
};

// Where a tag seems to lie, and how large it seems, by all posed frames that show it.
struct TagPlacement {
  TagPose T_anchor_tag;
  double scale = 1.0;  // its size over the one that its sightings say
  // One for each frame that shows it: the frame and how far off its corners are (RMS) [px].
  std::vector<std::pair<std::size_t, double>> errors_px;

  // Of the errors, none counted for more than kFarOff.
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
  double shift = 0.0;  // of edges that were not measured each for itself [px]
  bool shift_is_free = true;
  bool lens_is_free = false;
  std::stop_token stop;  // once requested, everything ends soon, with no use

  // The lens as given or as solved for, which may be none: an error says why.
  [[nodiscard]] Result<CameraModel> camera() const;
  // Poses cameras by placed tags. Where two poses explain a frame about as well, none is taken.
  void pose_cameras();
  // A frame that is posed, with the tag in it.
  using Seen = std::pair<std::size_t, const TagSighting*>;
  [[nodiscard]] std::vector<Seen> seen_of(int id, std::size_t first = 0,
                                          std::size_t last = kAllFrames) const;
  // The tag where it explains best what most posed frames of `first` to `last` (half open) show of
  // it, by one of them; nothing where that are fewer than two. Its size is `scale` times what its
  // sightings say.
  [[nodiscard]] std::optional<TagPlacement> place(int id, double scale = 1.0, std::size_t first = 0,
                                                  std::size_t last = kAllFrames) const;
  // The same by all of them together (cameras as they are), and with the size free where asked.
  [[nodiscard]] std::optional<TagPlacement> fit(int id, bool free_size, std::size_t first = 0,
                                                std::size_t last = kAllFrames) const;
  // How far off all posed frames show it from where `fit` has it.
  void measure(TagPlacement& fit, int id) const;
  // Least squares over all of them; false where that fails.
  bool adjust(bool robust);
  // Takes out sightings whose corners are off; true if there were any. `rms_px`: of what is left,
  // 2-D distance.
  bool drop_outliers(double& rms_px, int& corners);
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
