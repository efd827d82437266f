// Detects the tags of a rigid group in a frame and estimates the pose from their corners.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <tl/expected.hpp>
#include <vector>

#include "core/geometry/tag_map.hpp"
#include "core/geometry/tracking_reasons.hpp"
#include "tracking/detection/board_pose.hpp"
#include "tracking/detection/tag_search.hpp"
#include "tracking/pose_confidence.hpp"
#include "tracking/rigid_tags.hpp"
#include "tracking/tracked_frame.hpp"

namespace penumbra {

using MeasurementResult = tl::expected<Measurement, PoseReason>;

class CornerSearch {
 public:
  // `map`: all known tags. `search` may be shared with other groups.
  CornerSearch(TagMap map, std::shared_ptr<TagSearch> search)
      : map_(std::move(map)), search_(std::move(search)) {}

  // Searches the whole frame at one resolution.
  [[nodiscard]] MeasurementResult detect(const RigidTags& group, SearchResolution resolution,
                                         TrackTimes& times);
  // Searches the predicted region, then the whole frame: alternately at full resolution and at low
  // resolutions, in the first frame at all of them. Stops when the result is sufficient.
  [[nodiscard]] MeasurementResult find(const RigidTags& group, SearchResolution finest,
                                       const std::optional<MapFromCamera>& predicted,
                                       TrackTimes& times);
  // Estimates the pose from the corners of detected tags, without Ceres.
  [[nodiscard]] MeasurementResult measure(const RigidTags& group,
                                          std::span<const TagDetection> detections,
                                          TrackTimes& times);
  // Refines a measurement with Ceres, unless an alignment produced it.
  static void refine(const RigidTags& group, Measurement& measurement, TrackTimes& times);

  // Set the resolution of the next search.
  void begin_at_full_resolution() { full_next_ = true; }
  void begin_at_low_resolution() { full_next_ = false; }

  [[nodiscard]] TagSearch& frame() const { return *search_; }
  // Returns the tags of the latest measurement; their indices refer to RigidTags::tags.
  [[nodiscard]] std::span<const TagObservation> observations() const { return observations_; }

 private:
  TagMap map_;
  std::shared_ptr<TagSearch> search_;
  std::vector<TagObservation> observations_;
  bool full_next_ = false;
  bool searched_before_ = false;
};

}  // namespace penumbra
