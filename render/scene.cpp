#include "render/scene.hpp"

#include <algorithm>
#include <cmath>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// A keyframe by its index, counted on around a loop: with n keys whose last repeats the first, key
// n - 1 + i is key i, one period later.
struct KeyAt {
  double time_s = 0.0;
  const Placement* placement = nullptr;
};

KeyAt key_at(const Animation& animation, int index) {
  const std::vector<Keyframe>& keys = animation.keyframes;
  const int count = static_cast<int>(keys.size());
  if (!animation.loop || count < 2) {
    const Keyframe& key = keys[static_cast<std::size_t>(std::clamp(index, 0, count - 1))];
    return {key.time_s, &key.placement};
  }
  const int period = count - 1;
  const int turns = index >= 0 ? index / period : -((period - 1 - index) / period);
  const Keyframe& key = keys[static_cast<std::size_t>(index - turns * period)];
  return {key.time_s + turns * (keys.back().time_s - keys.front().time_s), &key.placement};
}

// Slope of a Catmull-Rom spline at key `index`, over uneven times; one-sided at the ends of a path
// that does not loop.
template <class Value>
Value slope_at(const Animation& animation, int index, Value Placement::*member) {
  const KeyAt before = key_at(animation, index - 1);
  const KeyAt after = key_at(animation, index + 1);
  const double span = after.time_s - before.time_s;
  if (!(span > 0.0)) return Value(before.placement->*member * 0.0);
  return Value((after.placement->*member - before.placement->*member) / span);
}

template <class Value>
Value hermite(const Animation& animation, int index, double s, double span,
              Value Placement::*member) {
  const Value p0 = key_at(animation, index).placement->*member;
  const Value p1 = key_at(animation, index + 1).placement->*member;
  if (animation.interpolation == Animation::Interpolation::linear) return Value(p0 + s * (p1 - p0));
  const Value m0 = slope_at(animation, index, member) * span;
  const Value m1 = slope_at(animation, index + 1, member) * span;
  const double s2 = s * s;
  const double s3 = s2 * s;
  return Value((2.0 * s3 - 3.0 * s2 + 1.0) * p0 + (s3 - 2.0 * s2 + s) * m0 +
               (3.0 * s2 - 2.0 * s3) * p1 + (s3 - s2) * m1);
}

Placement path_at(const Animation& animation, double time_s) {
  const std::vector<Keyframe>& keys = animation.keyframes;
  if (keys.empty()) return {};
  if (keys.size() == 1) return keys.front().placement;
  const double begin = keys.front().time_s;
  const double end = keys.back().time_s;
  double t = time_s;
  if (animation.loop) {
    t = begin + std::fmod(time_s - begin, end - begin);
    if (t < begin) t += end - begin;
  }
  if (t <= begin) return keys.front().placement;
  if (t >= end) return keys.back().placement;
  const auto next =
      std::upper_bound(keys.begin(), keys.end(), t,
                       [](double value, const Keyframe& key) { return value < key.time_s; });
  const int index = static_cast<int>(next - keys.begin()) - 1;
  const double span = next->time_s - std::prev(next)->time_s;
  const double s = (t - std::prev(next)->time_s) / span;

  Placement placement;
  placement.position = hermite(animation, index, s, span, &Placement::position);
  // A spline may overshoot; a scale must stay a scale.
  const double smallest = std::min(std::prev(next)->placement.scale, next->placement.scale);
  placement.scale = std::max(hermite(animation, index, s, span, &Placement::scale), 0.5 * smallest);
  // Eased along each turn, so that the turning rate is continuous (0 at the keys) where positions
  // are smooth.
  const double eased =
      animation.interpolation == Animation::Interpolation::smooth ? s * s * (3.0 - 2.0 * s) : s;
  placement.rotation = std::prev(next)->placement.rotation.slerp(eased, next->placement.rotation);
  return placement;
}

}  // namespace

SceneState evaluate_scene(const Scene& scene, double time_s) {
  PENUMBRA_ASSERT(std::isfinite(time_s));
  SceneState state;
  state.time_s = time_s;
  state.objects.reserve(scene.objects.size());
  for (const SceneObject& object : scene.objects) {
    Placement placement = object.placement * path_at(object.animation, time_s);
    if (object.animation.spin_turns_per_s != 0.0) {
      // Whole turns are taken off first: the angle stays exact however long the scene runs.
      const double turns = object.animation.spin_turns_per_s * time_s;
      const double angle = 2.0 * M_PI * (turns - std::floor(turns));
      placement.rotation =
          placement.rotation *
          Eigen::Quaterniond(Eigen::AngleAxisd(angle, object.animation.spin_axis.normalized()));
    }
    if (object.parent >= 0) {
      PENUMBRA_ASSERT(static_cast<std::size_t>(object.parent) < state.objects.size());
      placement = state.objects[static_cast<std::size_t>(object.parent)] * placement;
    }
    state.objects.push_back(placement);
  }
  return state;
}

}  // namespace penumbra
