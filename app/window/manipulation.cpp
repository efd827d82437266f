#include "app/window/manipulation.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Largest distance of a dragged point from the camera, relative to its distance when grabbed. Near
// the horizon one pixel corresponds to metres.
constexpr double kMaxDistanceRatio = 6.0;
// Smallest sine of the angle between the ray and the vertical plane of a lift.
constexpr double kMinSine = 0.35;
constexpr double kParallel = 1e-9;

Eigen::Vector3d to_double(const glm::vec3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

bool intersects_box(const Ray& ray, const Eigen::Vector3d& low, const Eigen::Vector3d& high) {
  double enter = 0.0;
  double leave = std::numeric_limits<double>::infinity();
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    const double d = ray.direction[axis];
    if (std::abs(d) < std::numeric_limits<double>::min()) {
      if (ray.origin[axis] < low[axis] || ray.origin[axis] > high[axis]) return false;
      continue;
    }
    const double a = (low[axis] - ray.origin[axis]) / d;
    const double b = (high[axis] - ray.origin[axis]) / d;
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return enter <= leave;
}

// Returns the distance along the ray to the triangle, front or back side (Moeller and Trumbore).
std::optional<double> distance_to_triangle(const Ray& ray, const Eigen::Vector3d& a,
                                           const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const Eigen::Vector3d ab = b - a;
  const Eigen::Vector3d ac = c - a;
  const Eigen::Vector3d p = ray.direction.cross(ac);
  const double determinant = ab.dot(p);
  if (determinant == 0.0 || !std::isfinite(determinant)) return std::nullopt;
  const Eigen::Vector3d from_a = ray.origin - a;
  const double u = from_a.dot(p) / determinant;
  const Eigen::Vector3d q = from_a.cross(ab);
  const double v = ray.direction.dot(q) / determinant;
  const double t = ac.dot(q) / determinant;
  if (!(u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0)) return std::nullopt;
  return t;
}

// Returns the distance along the ray to the plane; nullopt if it is behind the origin or parallel.
std::optional<double> distance_to_plane(const Ray& ray, const Eigen::Vector3d& normal,
                                        const Eigen::Vector3d& point) {
  const double along = ray.direction.dot(normal);
  if (std::abs(along) < kParallel) return std::nullopt;
  const double t = (point - ray.origin).dot(normal) / along;
  return t > 0.0 ? std::optional(t) : std::nullopt;
}

// Returns the horizontal normal of the vertical plane that contains `right`.
Eigen::Vector3d horizontal_normal(const PointerView& pointer) {
  return pointer.right.cross(Eigen::Vector3d::UnitZ()).normalized();
}

// Returns the topmost ancestor of an object, or the object itself.
int root_of(const Scene& scene, int object) {
  int root = object;
  while (scene.objects[static_cast<std::size_t>(root)].parent >= 0) {
    root = scene.objects[static_cast<std::size_t>(root)].parent;
  }
  return root;
}

}  // namespace

std::optional<PointerView> view_at(const CameraModel& camera, const CameraPose& T_table_camera,
                                   const Eigen::Vector2d& pixel) {
  const auto direction = camera.unproject(pixel);
  if (!direction || !T_table_camera.is_finite()) return std::nullopt;
  PointerView view;
  view.ray = {T_table_camera.translation(), (T_table_camera.rotation() * *direction).normalized()};
  view.pixel = pixel;
  Eigen::Vector3d right = T_table_camera.rotation() * Eigen::Vector3d::UnitX();
  right.z() = 0.0;
  // In an image rotated by 90 degrees the x axis is vertical, so the y axis is used.
  if (right.norm() < 1e-3) {
    right = T_table_camera.rotation() * Eigen::Vector3d::UnitY();
    right.z() = 0.0;
  }
  view.right = right.normalized();
  view.radians_per_px = 1.0 / camera.parameters().fx;
  view.width_px = camera.width();
  return view;
}

std::optional<PickedPoint> pick(const Scene& scene, const SceneState& state, const Ray& ray) {
  PENUMBRA_ASSERT(state.objects.size() == scene.objects.size());
  std::optional<PickedPoint> nearest;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const auto index = static_cast<int>(i);
    const std::shared_ptr<const Model> model = shape_of(scene, state, index);
    if (!model || opacity_of(state, index) <= 0.0) continue;
    const Placement T = placed_model(*model, state.objects[i]);
    // The ray in the object's frame. Its direction is scaled too, so that distances stay in metres.
    const Eigen::Quaterniond back = T.rotation.conjugate();
    const Ray local{back * (ray.origin - T.position) / T.scale, back * ray.direction / T.scale};
    if (!intersects_box(local, to_double(model->min_corner), to_double(model->max_corner))) {
      continue;
    }
    for (const Mesh& mesh : model->meshes) {
      for (std::size_t k = 0; k + 2 < mesh.indices.size(); k += 3) {
        const auto t = distance_to_triangle(local, to_double(mesh.positions[mesh.indices[k]]),
                                            to_double(mesh.positions[mesh.indices[k + 1]]),
                                            to_double(mesh.positions[mesh.indices[k + 2]]));
        if (t && (!nearest || *t < nearest->distance)) nearest = {index, *t};
      }
    }
  }
  return nearest;
}

double lowest_point(const Scene& scene, const SceneState& state, int root) {
  double lowest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const auto index = static_cast<int>(i);
    if (root_of(scene, index) != root) continue;
    const std::shared_ptr<const Model> model = shape_of(scene, state, index);
    if (!model) continue;
    const Eigen::Vector3d low = to_double(model->min_corner);
    const Eigen::Vector3d high = to_double(model->max_corner);
    for (unsigned corner = 0; corner < 8; ++corner) {
      const Eigen::Vector3d p((corner & 1U) != 0U ? high.x() : low.x(),
                              (corner & 2U) != 0U ? high.y() : low.y(),
                              (corner & 4U) != 0U ? high.z() : low.z());
      lowest = std::min(lowest, (placed_model(*model, state.objects[i]) * p).z());
    }
  }
  return lowest;
}

std::optional<ObjectPlaced> Manipulator::take(const Scene& scene, const SceneState& state,
                                              const PointerView& pointer, DragMode mode) {
  grab_.reset();
  const auto picked = pick(scene, state, pointer.ray);
  if (!picked || scene.objects[static_cast<std::size_t>(picked->object)].phantom) {
    selected_.clear();
    return std::nullopt;
  }
  const int root = root_of(scene, picked->object);
  Grab grab;
  grab.mode = mode;
  grab.object = scene.objects[static_cast<std::size_t>(root)].name;
  grab.start = state.objects[static_cast<std::size_t>(root)];
  grab.point = pointer.ray.origin + picked->distance * pointer.ray.direction;
  grab.distance = picked->distance;
  grab.clearance = std::max(0.0, lowest_point(scene, state, root));
  grab.pointer = pointer;
  selected_ = grab.object;
  grab_ = grab;
  return ObjectPlaced{grab.object, grab.start, false};
}

std::optional<ObjectPlaced> Manipulator::drag(const PointerView& pointer) const {
  if (!grab_) return std::nullopt;
  const Grab& grab = *grab_;
  ObjectPlaced placed{grab.object, grab.start, grab.mode == DragMode::turn};
  const Eigen::Vector2d moved = pointer.pixel - grab.pointer.pixel;
  switch (grab.mode) {
    case DragMode::slide: {
      const auto t = distance_to_plane(pointer.ray, Eigen::Vector3d::UnitZ(), grab.point);
      if (!t || *t > kMaxDistanceRatio * grab.distance) return std::nullopt;
      Eigen::Vector3d shift = pointer.ray.origin + *t * pointer.ray.direction - grab.point;
      shift.z() = 0.0;
      placed.placement.position += shift;
      break;
    }
    case DragMode::lift: {
      const Eigen::Vector3d normal = horizontal_normal(grab.pointer);
      Eigen::Vector3d shift;
      if (std::abs(grab.pointer.ray.direction.dot(normal)) > kMinSine) {
        const auto t = distance_to_plane(pointer.ray, normal, grab.point);
        if (!t || *t > kMaxDistanceRatio * grab.distance) return std::nullopt;
        shift = pointer.ray.origin + *t * pointer.ray.direction - grab.point;
        shift -= shift.dot(normal) * normal;  // removes the rounding error
      } else {
        // Seen from above, height is not visible: a drag up in the image lifts the object.
        const double metres_per_px = grab.distance * pointer.radians_per_px;
        shift =
            metres_per_px * (moved.x() * grab.pointer.right - moved.y() * Eigen::Vector3d::UnitZ());
      }
      shift.z() = std::max(shift.z(), -grab.clearance);
      placed.placement.position += shift;
      break;
    }
    case DragMode::reach: {
      // The plane of motion is seen edge-on, so a drag to the right moves the object away.
      const double metres_per_px = grab.distance * pointer.radians_per_px;
      Eigen::Vector3d shift = metres_per_px * (-moved.x() * horizontal_normal(grab.pointer) -
                                               moved.y() * Eigen::Vector3d::UnitZ());
      shift.z() = std::max(shift.z(), -grab.clearance);
      placed.placement.position += shift;
      break;
    }
    case DragMode::turn: {
      // A drag over the image's width is one full rotation.
      const double angle_per_px = 2.0 * std::numbers::pi / std::max(1.0, pointer.width_px);
      const Eigen::AngleAxisd yaw(moved.x() * angle_per_px, Eigen::Vector3d::UnitZ());
      const Eigen::AngleAxisd tilt(moved.y() * angle_per_px, grab.pointer.right);
      placed.placement.rotation = (tilt * yaw * grab.start.rotation).normalized();
      break;
    }
  }
  if (!placed.placement.position.allFinite() || !placed.placement.rotation.coeffs().allFinite()) {
    return std::nullopt;
  }
  return placed;
}

std::optional<ObjectPlaced> cursor_at(const Scene& scene, const SceneState& state,
                                      const PointerView& pointer, double raised) {
  constexpr double kMaxRay_m = 5.0;
  const auto cursor = std::ranges::find(scene.objects, true, &SceneObject::cursor);
  if (cursor == scene.objects.end() || !std::isfinite(raised)) return std::nullopt;
  const auto index = static_cast<int>(cursor - scene.objects.begin());
  ObjectPlaced placed{cursor->name, state.objects[static_cast<std::size_t>(index)], false};
  const double lowest = lowest_point(scene, state, index);
  const double clearance = std::isfinite(lowest) ? std::max(lowest, 0.0) : 0.0;
  Eigen::Vector3d& position = placed.placement.position;
  position.z() += std::max(raised, -clearance);
  const auto t = distance_to_plane(pointer.ray, Eigen::Vector3d::UnitZ(), position);
  if (!t || *t > kMaxRay_m) return std::nullopt;
  position.head<2>() = (pointer.ray.origin + *t * pointer.ray.direction).head<2>();
  return placed;
}

std::optional<ObjectPlaced> Manipulator::put(const Scene& scene, const SceneState& state,
                                             const PointerView& pointer) const {
  const auto object = std::ranges::find(scene.objects, selected_, &SceneObject::name);
  if (selected_.empty() || object == scene.objects.end() || object->parent >= 0) {
    return std::nullopt;
  }
  const auto t = distance_to_plane(pointer.ray, Eigen::Vector3d::UnitZ(), Eigen::Vector3d::Zero());
  if (!t) return std::nullopt;
  const auto index = static_cast<int>(object - scene.objects.begin());
  const double lowest = lowest_point(scene, state, index);
  ObjectPlaced placed{selected_, state.objects[static_cast<std::size_t>(index)], false};
  const Eigen::Vector3d target = pointer.ray.origin + *t * pointer.ray.direction;
  const double stand = std::isfinite(lowest) ? placed.placement.position.z() - lowest : 0.0;
  placed.placement.position = {target.x(), target.y(), stand};
  return placed;
}

}  // namespace penumbra
