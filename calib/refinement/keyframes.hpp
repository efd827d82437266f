// Chooses frames of a tracked session from which its tag map can be refined.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/evaluation/pose_velocity.hpp"

namespace penumbra {

struct MapKeyframe {
  std::vector<std::uint8_t> pixels;  // luma, rows top to bottom, without padding
  ImageSize size;
  Eigen::Vector3d camera_m;          // position of the camera in the table frame [m]
  std::optional<Vector6d> velocity;  // of the camera, as in SurveyFrame; nullopt if unknown
  bool held_out = false;             // judges refined maps; no map is made from it

  [[nodiscard]] ImageView luma() const {
    return {pixels.data(), size.width, size.height, size.width};
  }
};
using KeyframeList = std::vector<std::shared_ptr<const MapKeyframe>>;

// Keeps up to kMaxKeyframes frames whose cameras are far apart. Once that many are kept, the
// minimum distance grows, and those that are too near are dropped.
class MapKeyframes {
 public:
  static constexpr std::size_t kRefinementInterval = 8;
  static constexpr std::size_t kMaxKeyframes = 32;

  MapKeyframes(const CameraModel& camera, const TagMap& tags);

  // Keeps a copy of the image if the camera moves slowly and is far from all kept cameras. Returns
  // true if a refinement of the map is due: with 8 keyframes, 16, 24 and 32, and whenever 32 are
  // kept again. The following call replaces the keyframe by one with a more accurate velocity. Call
  // this for frames with a measured pose, in order.
  [[nodiscard]] bool add(ImageView luma, std::int64_t timestamp_ns,
                         const CameraPose& T_table_camera);
  [[nodiscard]] const KeyframeList& kept() const { return kept_; }
  // Number of keyframes that were chosen since the start.
  [[nodiscard]] int added() const { return added_; }

 private:
  [[nodiscard]] bool is_far_from_kept(const Eigen::Vector3d& camera_m) const;
  void thin_out();
  void complete_latest(const TimedPose& here);

  CameraModel camera_;
  Eigen::Vector3d middle_m_ = Eigen::Vector3d::Zero();  // of the table's tags
  double min_distance_;                                 // relative to the distance from the middle
  std::size_t due_ = kRefinementInterval;               // number of keyframes
  int added_ = 0;
  std::optional<TimedPose> previous_;  // of the previous frame
  // Pose before the latest keyframe, while that is the previous frame.
  std::optional<TimedPose> before_latest_;
  KeyframeList kept_;
};

}  // namespace penumbra
