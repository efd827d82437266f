// Detects while tracking that the tag map, the lens or the row time is wrong. See
// docs/tracking.md#systematic-errors.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "calib/survey/tag_corner_meter.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "tracking/evaluation/pose_velocity.hpp"
#include "tracking/evaluation/residual_causes.hpp"
#include "tracking/tracked_frame.hpp"

namespace penumbra {

class ResidualWatch {
 public:
  // Watches the tags of the table.
  [[nodiscard]] static Result<std::unique_ptr<ResidualWatch>> create(const CameraModel& camera,
                                                                     const TagMap& tags);

  // Call this for every tracked frame in order. Measures the corners of the tags in up to
  // kMaxFrames frames from different views, and tests their residuals. Adds the overlay error
  // because of the causes to the predicted error of the table's pose. If the sum is too large, the
  // pose becomes uncertain. Returns a notice for each cause that was found for the first time, with
  // the remedy.
  [[nodiscard]] std::vector<std::string> observe(TrackedFrame& tracked);
  static constexpr int kMaxFrames = 64;

  // Continues with another map of the same tags and another row time of the same camera; forgets
  // what was found with the previous ones.
  [[nodiscard]] Result<void> restart(const CameraModel& camera, const TagMap& tags);

  // Returns the standard deviation per axis of the tags' places in the map [m], for
  // GroupTracker::set_map_sigma(); 0 unless the map was found to be wrong.
  [[nodiscard]] double map_sigma_m() const { return map_sigma_m_; }
  // Returns the result of the latest test that found a cause; nullopt if more frames refuted it.
  // Any thread may call this.
  [[nodiscard]] std::optional<ResidualCauses> found() const;
  // Returns the result of the latest test; nullopt before the first one.
  [[nodiscard]] const std::optional<ResidualCauses>& latest() const { return latest_causes_; }

 private:
  ResidualWatch(const CameraModel& camera, std::vector<MappedTag> tags, TagCornerMeter meter);

  // A measured frame with its neighbours, which determine its velocity.
  struct Neighbours {
    std::optional<TimedPose> before;
    TimedPose here;
  };

  // Returns false once enough frames were measured, or too many could not be.
  [[nodiscard]] bool wants_frames() const;
  [[nodiscard]] bool shows_another_view(const MapFromCamera& pose) const;
  void measure(const Frame& frame, const TimedPose& here);
  [[nodiscard]] std::vector<std::string> test();
  [[nodiscard]] std::vector<std::string> new_notices(const ResidualCauses& causes);
  void add_error(PoseEstimate& pose) const;

  CameraModel camera_;
  std::vector<MappedTag> tags_;
  TagCornerMeter meter_;
  std::vector<FrameCorners> frames_;       // measured so far
  std::optional<MapFromCamera> measured_;  // pose of the latest frame that measure() was called for
  int failures_ = 0;                       // frames in which too few tags could be measured
  std::optional<TimedPose> previous_;      // of the previous frame
  std::optional<Neighbours> latest_;       // of frames_.back(), until the next frame
  std::array<bool, kErrorCauses> noticed_{};
  bool noticed_unclear_ = false;
  std::vector<std::uint8_t> scratch_;
  double error_px_ = 0.0;     // overlay error of the causes that were found
  double map_sigma_m_ = 0.0;  // see map_sigma_m()
  Suspects suspects_;         // their causes
  std::optional<ResidualCauses> latest_causes_;
  mutable std::mutex mutex_;  // guards found_: another thread tracks the frames
  std::optional<ResidualCauses> found_;
};

}  // namespace penumbra
