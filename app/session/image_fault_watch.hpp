// Detects why a session finds no tags: mirrored or negative images.
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

  // Call this for every tracked frame in order. Checks lost frames; after tags were detected once,
  // only from the kLongLoss-th consecutive lost frame on. Stops after the first fault or error.
  void observe(const TrackedFrame& tracked);
  static constexpr int kLongLoss = 60;
  [[nodiscard]] std::optional<ImageFault> fault() const;

 private:
  void end();
  std::optional<TagMap> tags_;       // nullopt once checking has ended
  std::optional<ImageCheck> check_;  // set while frames are lost
  bool seen_ = false;                // tags were detected in any frame
  int lost_ = 0;                     // consecutive lost frames
  std::vector<std::uint8_t> scratch_;
  mutable std::mutex mutex_;  // guards fault_: another thread tracks the frames
  std::optional<ImageFault> fault_;
};

}  // namespace penumbra
