// Radians inside, degrees only where a person types or reads them; nanoseconds inside, seconds in
// files.
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

}  // namespace penumbra
