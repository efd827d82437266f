// Detects that a session finds no tag because its images are mirrored or negative.
#pragma once

#include <cstdint>
#include <mutex>
#include <optional>
#include <vector>

#include "core/pose_estimate.hpp"
#include "core/tag_map.hpp"
#include "tracking/picture_check.hpp"
#include "tracking/table_tracker.hpp"

namespace penumbra {

class PictureWatch {
 public:
  explicit PictureWatch(const TagMap& tags) : tags_(tags) {}

  // Every tracked frame, in order. Warns once of what is found. Ends with the first frame in which
  // tags are seen, and costs nothing from then on.
  void saw(const TrackedFrame& tracked);
  [[nodiscard]] std::optional<PictureFault> fault() const;

 private:
  void end();
  std::optional<TagMap> tags_;         // until tags are seen or a fault is found
  std::optional<PictureCheck> check_;  // from the first lost frame on
  std::vector<std::uint8_t> scratch_;
  mutable std::mutex mutex_;  // frames are tracked by another thread than the one that reports
  std::optional<PictureFault> fault_;
};

}  // namespace penumbra
