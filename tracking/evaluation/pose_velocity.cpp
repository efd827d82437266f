#include "tracking/evaluation/pose_velocity.hpp"

#include <cmath>
#include <utility>

#include "core/units.hpp"
#include "tracking/math/se3.hpp"

namespace penumbra {
namespace {

constexpr double kMaxGap_s = 0.2;

// Returns the velocity between two poses and the time between them [s]; nullopt if it is unknown.
std::optional<std::pair<Vector6d, double>> velocity_between(const TimedPose& here,
                                                            const TimedPose* there) {
  if (there == nullptr || !here.pose || !there->pose) return std::nullopt;
  const double time_s = seconds(there->timestamp_ns - here.timestamp_ns);
  if (std::abs(time_s) > kMaxGap_s || time_s == 0.0) return std::nullopt;
  return std::pair(Vector6d(perturbation_between(*here.pose, *there->pose) / time_s),
                   std::abs(time_s));
}

}  // namespace

Vector6d velocity_at(const TimedPose* before, const TimedPose& here, const TimedPose* after) {
  const auto earlier = velocity_between(here, before);
  const auto later = velocity_between(here, after);
  if (earlier && later) {
    // The derivative of the parabola through three poses.
    const auto& [v0, t0] = *earlier;
    const auto& [v1, t1] = *later;
    return (v0 * t1 + v1 * t0) / (t0 + t1);
  }
  if (earlier) return earlier->first;
  return later ? later->first : Vector6d(Vector6d::Zero());
}

}  // namespace penumbra
