// Detects that a session finds no tag because its images are mirrored or negative.
#pragma once

#include <cstdint>
#include <mutex>
#include <optional>
#include <vector>

#include "core/geometry/tag_map.hpp"
#include "tracking/detection/image_check.hpp"
#include "tracking/tracked_frame.hpp"

namespace penumbra {

class ImageFaultWatch {
 public:
  explicit ImageFaultWatch(const TagMap& tags) : tags_(tags) {}

  // Call it for every tracked frame in order. Checks lost frames; once tags were seen, only after
  // kLongLoss of them in a row. Logs the first fault and checks no frame after it.
  void saw(const TrackedFrame& tracked);
  static constexpr int kLongLoss = 60;
  [[nodiscard]] std::optional<ImageFault> fault() const;

 private:
  void end();
  std::optional<TagMap> tags_;       // until a fault is found
  std::optional<ImageCheck> check_;  // while frames are lost
  bool seen_ = false;                // tags, in any frame
  int lost_ = 0;                     // frames in a row
  std::vector<std::uint8_t> scratch_;
  mutable std::mutex mutex_;  // frames are tracked by another thread than the one that reports
  std::optional<ImageFault> fault_;
};

}  // namespace penumbra
