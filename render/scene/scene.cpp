// Evaluates scenes over time.
#include "render/scene/scene.hpp"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <limits>
#include <numbers>
#include <set>

#include "core/assert.hpp"
#include "render/scene/sun.hpp"

namespace penumbra {
namespace {

constexpr double kMaxTurn_s = 3600.0;       // maximum sampled time of slow spins
constexpr std::size_t kHeightSamples = 64;  // sampled times, in addition to the keyframes

// Returns the spline's velocity at a key, from its two neighbours (non-uniform Catmull-Rom). The
// first and last key of a loop count as one key; open ends have the velocity of their segment.
Eigen::Vector3d velocity_at(const Animation& animation, std::size_t key) {
  const std::vector<Keyframe>& keys = animation.keyframes;
  const std::size_t last = keys.size() - 1;
  const auto slope = [&keys](std::size_t i) {  // velocity of the segment from key i
    return Eigen::Vector3d((keys[i + 1].placement.position - keys[i].placement.position) /
                           (keys[i + 1].time_s - keys[i].time_s));
  };
  if (key == 0 || key == last) {
    if (!animation.loop) return slope(key == 0 ? 0 : last - 1);
    const double before = keys[last].time_s - keys[last - 1].time_s;
    const double after = keys[1].time_s - keys[0].time_s;
    return (slope(last - 1) * before + slope(0) * after) / (before + after);
  }
  return (keys[key + 1].placement.position - keys[key - 1].placement.position) /
         (keys[key + 1].time_s - keys[key - 1].time_s);
}

Placement on_path(const Animation& animation, double time_s) {
  const std::vector<Keyframe>& keys = animation.keyframes;
  if (keys.empty()) return {};
  const double start = keys.front().time_s;
  const double period = keys.back().time_s - start;
  if (keys.size() == 1 || !(period > 0.0)) return keys.front().placement;
  double time = time_s;
  if (animation.loop) {
    time = start + std::fmod(time_s - start, period);
    if (time < start) time += period;
  }
  if (time <= start) return keys.front().placement;
  if (time >= keys.back().time_s) return keys.back().placement;
  const auto after =
      std::upper_bound(keys.begin(), keys.end(), time,
                       [](double value, const Keyframe& key) { return value < key.time_s; });
  const auto i = static_cast<std::size_t>(after - keys.begin()) - 1;
  const Keyframe& a = keys[i];
  const Keyframe& b = keys[i + 1];
  const double span = b.time_s - a.time_s;
  const double t = (time - a.time_s) / span;
  if (t == 0.0) return a.placement;
  Placement placement;
  if (animation.interpolation == Animation::Interpolation::linear) {
    placement.position = a.placement.position + t * (b.placement.position - a.placement.position);
  } else {  // cubic Hermite
    const double t2 = t * t, t3 = t2 * t;
    placement.position = (2.0 * t3 - 3.0 * t2 + 1.0) * a.placement.position +
                         (t3 - 2.0 * t2 + t) * span * velocity_at(animation, i) +
                         (-2.0 * t3 + 3.0 * t2) * b.placement.position +
                         (t3 - t2) * span * velocity_at(animation, i + 1);
  }
  placement.rotation = a.placement.rotation.slerp(t, b.placement.rotation);
  // Linear, because a cubic may overshoot below 0.
  placement.scale = a.placement.scale + t * (b.placement.scale - a.placement.scale);
  return placement;
}

Placement spun(const Animation& animation, double time_s) {
  Placement placement;
  const double turn = std::fmod(animation.spin_turns_per_s * time_s, 1.0);
  placement.rotation =
      Eigen::AngleAxisd(2.0 * std::numbers::pi * turn, animation.spin_axis.normalized());
  return placement;
}

struct PlacedGroup {
  Placement T_table_group;
  double opacity = 1.0;
};
PlacedGroup placed_group(const std::string& name, std::span<const GroupEstimate> groups) {
  if (name == kTableGroup) return {};
  PlacedGroup placed;
  placed.opacity = 0.0;
  const auto group = std::ranges::find(groups, name, &GroupEstimate::name);
  if (group == groups.end() || !group->has_pose() || !group->T_table_group.is_finite()) {
    return placed;
  }
  placed.T_table_group.position = group->T_table_group.translation();
  placed.T_table_group.rotation = group->T_table_group.rotation();
  placed.opacity = opacity_for(group->status, group->held_from, group->age_s);
  return placed;
}

}  // namespace

double opacity_for(TrackStatus status, TrackStatus held_from, double age_s) {
  // A pose that may be wrong must look different from a tracked one.
  constexpr double kUncertainOpacity = 0.5;
  const auto fresh_opacity = [](TrackStatus of_pose) {
    return of_pose == TrackStatus::uncertain ? kUncertainOpacity : 1.0;
  };
  if (status == TrackStatus::lost) return 0.0;
  if (status != TrackStatus::held) return fresh_opacity(status);
  return fresh_opacity(held_from) * std::clamp(1.0 - age_s / kHoldSeconds, 0.0, 1.0);
}

PlacedLight default_light() {
  return {{-0.35, -0.45, 0.82, 0.0}, Eigen::Vector3d::Constant(0.8)};
}

SceneState evaluate_scene(const Scene& scene, double time_s,
                          std::span<const GroupEstimate> groups) {
  PENUMBRA_ASSERT(std::isfinite(time_s));
  SceneState state;
  state.time_s = time_s;
  state.objects.reserve(scene.objects.size());
  state.opacities.reserve(scene.objects.size());
  for (const SceneObject& object : scene.objects) {
    double opacity = 1.0;
    Placement placement = object.placement * on_path(object.animation, time_s);
    if (object.animation.spin_turns_per_s != 0.0) {
      placement = placement * spun(object.animation, time_s);
    }
    if (object.parent >= 0) {
      PENUMBRA_ASSERT(static_cast<std::size_t>(object.parent) < state.objects.size());
      placement = state.objects[static_cast<std::size_t>(object.parent)] * placement;
      opacity = state.opacities[static_cast<std::size_t>(object.parent)];
    } else if (object.tag_group != kTableGroup) {
      const PlacedGroup group = placed_group(object.tag_group, groups);
      placement = group.T_table_group * placement;
      opacity = group.opacity;
    }
    if (object.removed) opacity = 0.0;
    state.objects.push_back(placement);
    state.opacities.push_back(opacity);
    if (!object.playback.model) continue;
    state.poses.resize(scene.objects.size(), 0.0);
    state.poses[state.objects.size() - 1] = object.playback.time_at(time_s);
  }
  state.planes.reserve(scene.planes.size());
  for (const ScenePlane& plane : scene.planes) {
    PlacedPlane placed{PlaneFrame::make(plane.normal, plane.point)};
    if (plane.tag_group != kTableGroup) {
      const PlacedGroup group = placed_group(plane.tag_group, groups);
      const Placement& T = group.T_table_group;
      PlaneFrame& frame = placed.frame;
      frame = {T.rotation * frame.n, T * frame.q, T.rotation * frame.e1, T.rotation * frame.e2};
      placed.opacity = group.opacity;
    }
    state.planes.push_back(placed);
  }
  state.lights.reserve(scene.lights.size());
  for (const SceneLight& light : scene.lights) {
    PlacedLight placed;
    placed.color = light.color * light.intensity;
    Placement moved = on_path(light.animation, time_s);
    if (light.animation.spin_turns_per_s != 0.0) moved = moved * spun(light.animation, time_s);
    if (light.sun) {
      const SunPosition at =
          sun_position(light.sun->start_utc_s + 3600.0 * light.sun->hours_per_s * time_s,
                       light.sun->latitude_deg, light.sun->longitude_deg);
      const Eigen::Vector3d direction = direction_to(at, light.sun->north_deg);
      placed.position << direction, 0.0;
      if (!(direction.z() > 0.0)) placed.color.setZero();
    } else if (light.kind == SceneLight::Kind::point) {
      placed.position << light.position + moved.position, 1.0;
    } else {
      placed.position << moved.rotation * light.direction, 0.0;
    }
    state.lights.push_back(placed);
  }
  return state;
}

double Playback::time_at(double scene_time_s) const {
  const double time_s = start_s + speed * scene_time_s;
  const double end_s = model->end_s();
  if (!loop || !(end_s > 0.0)) return std::clamp(time_s, 0.0, end_s);
  const double since_start_s = std::fmod(time_s, end_s);
  return since_start_s < 0.0 ? since_start_s + end_s : since_start_s;
}

double pose_of(const SceneState& state, int object) {
  const auto index = static_cast<std::size_t>(object);
  return index < state.poses.size() ? state.poses[index] : 0.0;
}

std::shared_ptr<const Model> shape_of(const Scene& scene, const SceneState& state, int object,
                                      bool* is_missing) {
  const SceneObject& shown = scene.objects[static_cast<std::size_t>(object)];
  if (!shown.playback.model) return shown.model;
  const auto shape = shown.playback.model->at(pose_of(state, object));
  if (is_missing != nullptr) *is_missing = !shape;
  return shape.value_or(shown.model);
}

Placement placed_model(const Model& model, const Placement& T_world_object) {
  // Avoids rounding if the origin is zero.
  if (model.origin.isZero(0.0)) return T_world_object;
  return {T_world_object * model.origin, T_world_object.rotation, T_world_object.scale};
}

const std::shared_ptr<const Model>& casting_model(const SceneObject& object, bool proxies) {
  return proxies && object.proxy_model ? object.proxy_model : object.model;
}

PlacedPlane placed_plane(const Scene& scene, const SceneState& state, int plane) {
  const auto index = static_cast<std::size_t>(plane);
  if (index < state.planes.size()) return state.planes[index];
  return {PlaneFrame::make(scene.planes[index].normal, scene.planes[index].point)};
}

double opacity_of(const SceneState& state, int object) {
  const auto index = static_cast<std::size_t>(object);
  return index < state.opacities.size() ? state.opacities[index] : 1.0;
}

std::vector<std::string> tag_groups_of(const Scene& scene) {
  std::set<std::string> groups;
  for (const SceneObject& object : scene.objects) groups.insert(object.tag_group);
  for (const ShadowNode& node : scene.shadows) {
    for (const std::vector<int>* planes : {&node.planes, &node.walls}) {
      for (const int plane : *planes) {
        groups.insert(scene.planes[static_cast<std::size_t>(plane)].tag_group);
      }
    }
  }
  groups.erase(std::string(kTableGroup));
  return {groups.begin(), groups.end()};
}

std::vector<double> largest_scales(const Scene& scene) {
  std::vector<double> scales;
  scales.reserve(scene.objects.size());
  for (const SceneObject& object : scene.objects) {
    // The scale is linear between keys.
    double largest = object.animation.keyframes.empty() ? 1.0 : 0.0;
    for (const Keyframe& key : object.animation.keyframes) {
      largest = std::max(largest, key.placement.scale);
    }
    const double parent = object.parent < 0 ? 1.0 : scales[static_cast<std::size_t>(object.parent)];
    scales.push_back(parent * object.placement.scale * largest);
  }
  return scales;
}

namespace {

// Returns for each object the maximum of height(model, placement, maximum so far) over all sampled
// times; -infinity for an object without a model.
template <class Height>
std::vector<double> greatest_over_time(const Scene& scene, const Height& height) {
  std::set<double> times = {0.0};
  double end = 0.0;
  for (const SceneObject& object : scene.objects) {
    const std::vector<Keyframe>& keys = object.animation.keyframes;
    const double turns_per_s = std::abs(object.animation.spin_turns_per_s);
    if (turns_per_s > 0.0) end = std::max(end, std::min(1.0 / turns_per_s, kMaxTurn_s));
    if (keys.empty()) continue;
    end = std::max(end, keys.back().time_s);
    for (std::size_t i = 0; i < keys.size(); i += 1 + keys.size() / kHeightSamples) {
      times.insert(keys[i].time_s);
    }
  }
  // A smooth path may overshoot its keys.
  for (std::size_t i = 1; end > 0.0 && i <= kHeightSamples; ++i) {
    times.insert(end * static_cast<double>(i) / static_cast<double>(kHeightSamples));
  }
  std::vector<double> heights(scene.objects.size(), -std::numeric_limits<double>::infinity());
  for (const double time : times) {
    const SceneState state = evaluate_scene(scene, time);
    for (std::size_t i = 0; i < heights.size(); ++i) {
      const SceneObject& object = scene.objects[i];
      if (!object.model) continue;
      const Model& model = object.playback.model ? object.playback.model->box() : *object.model;
      heights[i] =
          std::max(heights[i], height(model, placed_model(model, state.objects[i]), heights[i]));
    }
  }
  return heights;
}

}  // namespace

std::vector<double> sphere_heights(const Scene& scene, const Eigen::Vector3d& plane_normal,
                                   const Eigen::Vector3d& plane_point) {
  return greatest_over_time(scene, [&](const Model& model, const Placement& at, double) {
    const glm::dvec3 farthest(glm::max(glm::abs(model.min_corner), glm::abs(model.max_corner)));
    const double radius = std::hypot(std::hypot(farthest.x, farthest.y), farthest.z);
    return plane_normal.dot(at.position - plane_point) + at.scale * radius;
  });
}

std::vector<double> vertex_heights(const Scene& scene, const Eigen::Vector3d& plane_normal,
                                   const Eigen::Vector3d& plane_point) {
  return greatest_over_time(scene, [&](const Model& model, const Placement& at, double known_max) {
    // Height of the bounding box's highest corner above the origin, unscaled.
    const Eigen::Vector3d up = at.rotation.conjugate() * plane_normal;
    double box_top = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
      box_top += up[axis] * static_cast<double>(up[axis] > 0.0 ? model.max_corner[axis]
                                                               : model.min_corner[axis]);
    }
    const double origin = plane_normal.dot(at.position - plane_point);
    // Visits the vertices only if the box may exceed the known maximum.
    if (origin + at.scale * box_top <= known_max) return known_max;
    double top = -std::numeric_limits<double>::infinity();
    for (const Mesh& mesh : model.meshes) {
      for (const glm::vec3& p : mesh.positions) {
        top = std::max(top, up.x() * static_cast<double>(p.x) + up.y() * static_cast<double>(p.y) +
                                up.z() * static_cast<double>(p.z));
      }
    }
    return origin + at.scale * top;
  });
}

void add_default_walls(Scene& scene, ShadowNode& node) {
  constexpr double kMinHorizontalNormalZ = 0.99;  // minimum z of a horizontal plane's normal
  for (const int plane : node.planes) {
    if (scene.planes[static_cast<std::size_t>(plane)].normal.z() < kMinHorizontalNormalZ) return;
  }
  if (node.planes.empty() || node.casters.empty()) return;
  const double floor = scene.planes[static_cast<std::size_t>(node.planes.front())].point.z();
  // Returns the casters' maximum coordinate along a direction.
  const auto max_coordinate = [&](const Eigen::Vector3d& direction) {
    const std::vector<double> heights = sphere_heights(scene, direction, Eigen::Vector3d::Zero());
    double highest = -std::numeric_limits<double>::infinity();
    for (const int caster : node.casters) {
      highest = std::max(highest, heights[static_cast<std::size_t>(caster)]);
    }
    return highest;
  };
  const double left = -max_coordinate(-Eigen::Vector3d::UnitX());
  const double right = max_coordinate(Eigen::Vector3d::UnitX());
  const double front = -max_coordinate(-Eigen::Vector3d::UnitY());
  const double back = max_coordinate(Eigen::Vector3d::UnitY());
  const double height = max_coordinate(Eigen::Vector3d::UnitZ()) - floor;
  if (!std::isfinite(left) || !(height > 0.0)) return;
  const auto add_wall = [&](const char* side, const Eigen::Vector3d& normal, double x, double y,
                            double half_width) {
    ScenePlane wall;
    wall.name = node.name + ": virtual " + side + " wall";
    wall.normal = normal;
    wall.point = {x, y, floor};
    wall.outline = {
        {-half_width, 0.0}, {half_width, 0.0}, {half_width, height}, {-half_width, height}};
    const auto earlier = std::ranges::find(scene.planes, wall.name, &ScenePlane::name);
    if (node.default_walls && earlier != scene.planes.end()) {
      *earlier = std::move(wall);
      return;
    }
    node.walls.push_back(static_cast<int>(scene.planes.size()));
    scene.planes.push_back(std::move(wall));
  };
  add_wall("back", -Eigen::Vector3d::UnitY(), 0.5 * (left + right), back, 0.5 * (right - left));
  add_wall("left", Eigen::Vector3d::UnitX(), left, 0.5 * (front + back), 0.5 * (back - front));
}

void add_object(Scene& scene, SceneObject object) {
  const auto index = static_cast<int>(scene.objects.size());
  object.added = true;
  const bool casts = object.casts_shadow;
  scene.objects.push_back(std::move(object));
  if (!casts) return;
  std::set<int> covered;  // planes that show the object's shadow
  for (const bool layered : {true, false}) {
    for (ShadowNode& node : scene.shadows) {
      if ((node.technique == ShadowTechnique::layered) != layered) continue;
      const auto is_covered = [&covered](int plane) { return covered.contains(plane); };
      if (std::ranges::any_of(node.planes, is_covered)) continue;
      covered.insert(node.planes.begin(), node.planes.end());
      node.casters.push_back(index);
      if (node.default_walls) add_default_walls(scene, node);
    }
  }
}

std::string free_object_name(const Scene& scene, const std::string& wanted) {
  std::string name = wanted;
  for (int i = 2; std::ranges::find(scene.objects, name, &SceneObject::name) != scene.objects.end();
       ++i) {
    name = wanted + " " + std::to_string(i);
  }
  return name;
}

}  // namespace penumbra
