// Decides when to begin with the next image, so that it is as fresh as possible, but not late, when
// the drawing of the last one ends.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

namespace penumbra {

// Times are of one clock [ns]. Not thread-safe.
class DrawPace {
 public:
  // The drawer has taken an image.
  void took(std::int64_t now_ns) { took_ns_ = now_ns; }
  // The drawer asks for the next one.
  void asked(std::int64_t now_ns) {
    if (took_ns_ && now_ns >= *took_ns_) drawings_.add(now_ns - *took_ns_);
    took_ns_.reset();
  }
  // Decoding and tracking an image took this long.
  void prepared(std::int64_t duration_ns) { preparations_.add(duration_ns); }

  // When to begin so that the image is ready for the shortest recent drawing time and the longest
  // recent preparation. Nothing: at once, because the drawer waits or no times are known.
  [[nodiscard]] std::optional<std::int64_t> begin_at_ns() const {
    constexpr std::int64_t kSlack_ns = 1'000'000;  // threads do not wake at once
    if (!took_ns_ || drawings_.values().empty() || preparations_.values().empty()) {
      return std::nullopt;
    }
    const std::int64_t drawing = std::ranges::min(drawings_.values());
    const std::int64_t preparation = std::ranges::max(preparations_.values());
    return *took_ns_ + std::max<std::int64_t>(drawing - preparation - kSlack_ns, 0);
  }

 private:
  // Ring of the last values.
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

  Recent drawings_, preparations_;
  std::optional<std::int64_t> took_ns_;  // while an image is drawn
};

}  // namespace penumbra
