// splitmix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators"): small,
// and the same numbers everywhere, unlike the standard library's distributions. Not for secrets.
#pragma once

#include <cstddef>
#include <cstdint>

namespace penumbra {

class SplitMix64 {
 public:
  explicit SplitMix64(std::uint64_t seed) : state_(seed) {}
  // A stream for one purpose; those of one seed have nothing to do with each other.
  SplitMix64(std::uint64_t seed, std::uint64_t purpose) : state_(seed) {
    state_ = next() ^ (purpose * 0xD1342543DE82EF95U);
  }

  std::uint64_t next() {
    state_ += kStep;
    return mixed(state_);
  }
  // In [low, high).
  double between(double low, double high) {
    return low + (high - low) * (static_cast<double>(next() >> 11U) * 0x1p-53);
  }
  // In [0, count); count > 0, far below 2^64.
  std::size_t below(std::size_t count) { return static_cast<std::size_t>(next() % count); }

  // What the n-th next() of a seed gives, from 0.
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
