// When to begin with the picture that is drawn next, so that it is as fresh as can be when the
// drawer is done with the one before, and yet not late.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace penumbra {

// Times are of one clock [ns]. Not for several threads at once.
class DrawPace {
 public:
  // The drawer has taken a picture; it asks for the next one.
  void took(std::int64_t now_ns);
  void asked(std::int64_t now_ns);
  // To decode and track a picture took so long.
  void prepared(std::int64_t duration_ns);

  // Begun now, a picture is ready when the drawer asks, were it drawing as fast and the work as
  // slow as they were at their fastest and slowest of late. Nothing: at once, the drawer waits or
  // nothing is known of it yet.
  [[nodiscard]] std::optional<std::int64_t> begin_at_ns() const;

 private:
  // The last few of a kind.
  class Recent {
   public:
    void add(std::int64_t value) { values_[count_++ % values_.size()] = value; }
    [[nodiscard]] std::optional<std::int64_t> least() const;
    [[nodiscard]] std::optional<std::int64_t> most() const;

   private:
    std::array<std::int64_t, 8> values_{};
    std::size_t count_ = 0;
  };

  Recent drawings_, preparations_;
  std::optional<std::int64_t> took_ns_;  // while a picture is drawn
};

}  // namespace penumbra
