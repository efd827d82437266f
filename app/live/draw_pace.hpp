// Decides when to start preparing (decoding and tracking) the next image: as late as possible, so
// that it is fresh, but early enough to be ready when the drawing of the previous image ends.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

namespace penumbra {

// All times are from one clock [ns]. Not thread-safe.
class DrawPace {
 public:
  // Call this when the drawer (the drawing thread) takes an image.
  void image_taken(std::int64_t now_ns) { drawing_since_ns_ = now_ns; }
  // Call this when the drawer requests the next image.
  void image_requested(std::int64_t now_ns) {
    if (drawing_since_ns_ && now_ns >= *drawing_since_ns_)
      draw_times_ns_.add(now_ns - *drawing_since_ns_);
    drawing_since_ns_.reset();
  }
  // Adds the time that preparing an image took.
  void add_preparation(std::int64_t duration_ns) { preparation_times_ns_.add(duration_ns); }

  // Returns when to start preparing, assuming the shortest recent drawing time and the longest
  // recent preparation; nullopt to start at once: the drawer waits, or no times are known.
  [[nodiscard]] std::optional<std::int64_t> begin_at_ns() const {
    constexpr std::int64_t kSlack_ns = 1'000'000;  // margin for the wake-up of threads
    if (!drawing_since_ns_ || draw_times_ns_.values().empty() ||
        preparation_times_ns_.values().empty()) {
      return std::nullopt;
    }
    const std::int64_t drawing = std::ranges::min(draw_times_ns_.values());
    const std::int64_t preparation = std::ranges::max(preparation_times_ns_.values());
    return *drawing_since_ns_ + std::max<std::int64_t>(drawing - preparation - kSlack_ns, 0);
  }

 private:
  // Ring buffer of the most recent values.
  class Recent {
   public:
    void add(std::int64_t value) { ring_[count_++ % ring_.size()] = value; }
    [[nodiscard]] std::span<const std::int64_t> values() const {
      return std::span(ring_).first(std::min(count_, ring_.size()));
    }

   private:
    std::array<std::int64_t, 8> ring_{};
    std::size_t count_ = 0;
  };

  Recent draw_times_ns_, preparation_times_ns_;
  std::optional<std::int64_t> drawing_since_ns_;  // while an image is drawn
};

}  // namespace penumbra
