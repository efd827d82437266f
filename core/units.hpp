// Angles: radians in code, degrees for users. Times: nanoseconds in code, seconds in files.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>

namespace penumbra {

constexpr double radians(double degrees) {
  return degrees * std::numbers::pi / 180.0;
}
constexpr double degrees(double radians) {
  return radians * 180.0 / std::numbers::pi;
}

constexpr double seconds(std::int64_t nanoseconds) {
  return static_cast<double>(nanoseconds) * 1e-9;
}
inline std::int64_t nanoseconds(double seconds) {
  return std::llround(seconds * 1e9);
}

// Returns |a - b| without overflow.
constexpr std::uint64_t distance_ns(std::int64_t a, std::int64_t b) {
  const auto unsigned_a = static_cast<std::uint64_t>(a);
  const auto unsigned_b = static_cast<std::uint64_t>(b);
  return a > b ? unsigned_a - unsigned_b : unsigned_b - unsigned_a;
}

}  // namespace penumbra
