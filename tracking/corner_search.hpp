// Detects the tags of a rigid group in a frame and finds the pose by their corners.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "tracking/detection/board_pose.hpp"
#include "tracking/detection/tag_search.hpp"
#include "tracking/measurement.hpp"
#include "tracking/rigid_tags.hpp"
#include "tracking/tracked_frame.hpp"

namespace penumbra {

class CornerSearch {
 public:
  // `map`: every tag that is known to lie somewhere. `search` may be shared with other groups.
  CornerSearch(TagMap map, std::shared_ptr<TagSearch> search)
      : map_(std::move(map)), search_(std::move(search)) {}

  // Searches the whole frame at one resolution.
  [[nodiscard]] Result<Measurement> detect(const RigidTags& group, SearchResolution resolution,
                                           TrackTimes& times);
  // Searches the region where the tags were predicted, then the whole frame: at low and at full
  // resolution in turn, so that a group that is lost for long costs no more than detection does.
  // The first frame may be the only one, and is searched at every resolution.
  [[nodiscard]] Result<Measurement> find(const RigidTags& group, SearchResolution finest,
                                         const std::optional<CameraPose>& predicted,
                                         TrackTimes& times);
  // The pose by the corners of detected tags, by this project's own solver.
  [[nodiscard]] Result<Measurement> measure(const RigidTags& group,
                                            std::span<const TagDetection> detections,
                                            TrackTimes& times);
  // Refines a measurement that no alignment replaced by Ceres.
  static void refine(const RigidTags& group, Measurement& measurement, TrackTimes& times);

  // The next frame is searched at full resolution at once.
  void begin_at_full_resolution() { full_next_ = true; }
  void begin_at_low_resolution() { full_next_ = false; }

  [[nodiscard]] TagSearch& frame() const { return *search_; }
  // Tags of the last measurement; their ids are places in RigidTags::tags, because tags of several
  // families may have the same ids.
  [[nodiscard]] std::span<const TagObservation> observations() const { return observations_; }

 private:
  TagMap map_;
  std::shared_ptr<TagSearch> search_;
  std::vector<TagObservation> observations_;
  bool full_next_ = false;
  bool searched_before_ = false;
};

}  // namespace penumbra
