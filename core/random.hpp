// splitmix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators"): the
// same numbers on every platform, unlike the standard library's distributions.
#pragma once

#include <cstddef>
#include <cstdint>

namespace penumbra {

class SplitMix64 {
 public:
  explicit SplitMix64(std::uint64_t seed) : state_(seed) {}
  // Different purposes give independent streams from the same seed.
  SplitMix64(std::uint64_t seed, std::uint64_t purpose) : state_(seed) {
    state_ = next() ^ (purpose * 0xD1342543DE82EF95U);
  }

  std::uint64_t next() {
    state_ += kStep;
    return mixed(state_);
  }
  // Returns a number in [low, high).
  double between(double low, double high) {
    return low + (high - low) * (static_cast<double>(next() >> 11U) * 0x1p-53);
  }
  // Returns a number in [0, count). `count` must be positive and much less than 2^64.
  std::size_t below(std::size_t count) { return static_cast<std::size_t>(next() % count); }

  // Returns the n-th (from 0) value of next() for this seed.
  [[nodiscard]] static std::uint64_t nth(std::uint64_t seed, std::uint64_t n) {
    return mixed(seed + kStep * (n + 1U));
  }

 private:
  static constexpr std::uint64_t kStep = 0x9E3779B97F4A7C15U;
  static std::uint64_t mixed(std::uint64_t z) {
    z = (z ^ (z >> 30U)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27U)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31U);
  }
  std::uint64_t state_;
};

}  // namespace penumbra
