#include "render/frame_plan.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <utility>

#include "core/assert.hpp"
#include "render/camera_gl.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/projected/light_rays.hpp"
#include "render/shadow/projected/projected_shadow.hpp"

namespace penumbra {
namespace {

const Eigen::Vector3d kLuminance(0.2126, 0.7152, 0.0722);

using BoxCorners = std::array<Eigen::Vector3d, 8>;

BoxCorners box_corners(const Model& model, const Placement& T_table_object) {
  BoxCorners corners;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const auto pick = [i, &model](glm::length_t axis) {
      return static_cast<double>((i >> static_cast<std::size_t>(axis) & 1U) != 0U
                                     ? model.max_corner[axis]
                                     : model.min_corner[axis]);
    };
    corners[i] = T_table_object * Eigen::Vector3d(pick(0), pick(1), pick(2));
  }
  return corners;
}

struct Disc {  // on a plane
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0.0;
};

// The lowest and the highest corner's height [m].
std::pair<double, double> heights_above(const PlaneFrame& plane, const BoxCorners& corners) {
  double bottom = std::numeric_limits<double>::infinity();
  double top = -bottom;
  for (const Eigen::Vector3d& corner : corners) {
    const double h = plane.height(corner);
    bottom = std::min(bottom, h);
    top = std::max(top, h);
  }
  return {bottom, top};
}

// Returns a disc that holds the box's image straight down.
Disc footprint(const BoxCorners& corners, const PlaneFrame& plane) {
  Disc disc;
  for (const Eigen::Vector3d& corner : corners)
    disc.centre += plane.to_plane(corner).head<2>() / 8.0;
  for (const Eigen::Vector3d& corner : corners) {
    disc.radius = std::max(disc.radius, (plane.to_plane(corner).head<2>() - disc.centre).norm());
  }
  return disc;
}

// Returns a disc that holds every layer. A kernel lies inside the footprint's bounding circle of
// radius r, so an imaginary vertex k + s (x - k) is at most s r + (s - 1) r away from its centre.
// The rest is slack for kernels that stand a raster cell outside.
Disc shadow_bounds(const BoxCorners& corners, const ShadowDraw& draw, double top) {
  Disc disc = footprint(corners, draw.plane_frame);
  double s = 1.0;
  // A part's light at the middle of the part, no larger than a times the disc: the image of its rim
  // is at most r + 2 t r + a t r away, less than the (2 s - 1) r of kernels.
  if (draw.technique != ShadowTechnique::simple) {
    for (const ShadowLayer layer : {ShadowLayer::umbra, ShadowLayer::penumbra}) {
      const HeightRange range = layer_height_range(draw.constants, layer);
      s = std::max(s, layer_factor(draw.constants, layer, std::clamp(top, range.low, range.high)));
    }
  }
  // A light of one size may move a vertex by up to 2.5 radii of a disc of hardly one cell.
  const double reach = draw.light_mode == LightMode::fixed ? 2.5 : 2.0;
  disc.radius *= 1.05 * (reach * s - 1.0);
  return disc;
}

// Whether the rectangle from `least` to `greatest` misses the outline's bounds.
bool misses_outline(const Eigen::Vector2d& least, const Eigen::Vector2d& greatest,
                    const std::vector<Eigen::Vector2d>& outline) {
  if (outline.empty()) return false;
  Eigen::Vector2d low = outline.front();
  Eigen::Vector2d high = outline.front();
  for (const Eigen::Vector2d& p : outline) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  return ((low.array() > greatest.array()) || (high.array() < least.array())).any();
}

bool misses_outline(const Disc& disc, const std::vector<Eigen::Vector2d>& outline) {
  return misses_outline(disc.centre.array() - disc.radius, disc.centre.array() + disc.radius,
                        outline);
}

// Surfaces that blend receive no shadows; phantoms are drawn whole, by their depth alone.
bool all_blends(const Model& model) {
  return std::ranges::all_of(model.meshes, [&model](const Mesh& mesh) {
    const auto at = static_cast<std::size_t>(mesh.material);
    return mesh.material >= 0 && at < model.materials.size() &&
           model.materials[at].alpha_mode == AlphaMode::blend;
  });
}

class Planner {
 public:
  Planner(const Scene& scene, const SceneState& state, const CameraModel& camera,
          const PlanOptions& options, FramePlan& plan)
      : scene_(scene),
        state_(state),
        options_(options),
        plan_(plan),
        frustum_(make_frustum(camera)),
        T_camera_table_(plan.T_table_camera.inverse()) {}

  void plan_objects() {
    for (std::size_t i = 0; i < scene_.objects.size(); ++i) {
      const SceneObject& object = scene_.objects[i];
      if (!object.model) continue;  // a joint of the hierarchy
      const auto index = static_cast<int>(i);
      const ObjectDraw draw{index, placement_of_model(index), opacity_of_object(index)};
      if (draw.opacity <= 0.0F) {
        skip(SkipReason::object_group_not_seen, index);
        continue;
      }
      if (options_.skip && out_of_view(box_corners(*object.model, draw.T_table_object))) {
        skip(SkipReason::object_out_of_view, index);
        continue;
      }
      (object.phantom ? plan_.phantoms : plan_.objects).push_back(draw);
    }
  }

  void plan_shadows() {
    for (std::size_t n = 0; n < scene_.shadows.size(); ++n) {
      const ShadowNode& node = scene_.shadows[n];
      const ShadowTechnique technique = options_.technique.value_or(node.technique);
      if (technique == ShadowTechnique::none) {
        skip(SkipReason::technique_none, static_cast<int>(n));
        continue;
      }
      for (const int plane_index : planes_of(node, technique)) {
        const ScenePlane& plane = scene_.planes[static_cast<std::size_t>(plane_index)];
        const PlacedPlane placed = placed_plane(scene_, state_, plane_index);
        const PlaneFrame& frame = placed.frame;
        if (placed.opacity <= 0.0) {
          skip(SkipReason::plane_group_not_seen, plane_index);
          continue;
        }
        const PlaneReceiver receiver{
            plane_index, frame,
            std::min(plan_.overlay_opacity, static_cast<float>(placed.opacity))};
        // A plane is invisible from behind, with and without `skip`.
        if (frame.height(plan_.T_table_camera.translation()) <= 0.0) {
          skip(SkipReason::camera_behind_plane, plane_index);
          continue;
        }
        if (std::ranges::find(plan_.receivers, plane_index, &PlaneReceiver::plane) ==
            plan_.receivers.end()) {
          plan_.receivers.push_back(receiver);
        }
        if (technique == ShadowTechnique::volume) continue;  // not for each plane: below
        if (technique == ShadowTechnique::hard) {
          plan_hard_shadows(node, static_cast<int>(n), receiver);
          continue;
        }
        const LightFractions fractions =
            lifted_by_ambient(node.fractions, scene_, state_.lights, frame.n, frame.q);
        for (const int caster : node.casters) {
          ShadowDraw draw;
          draw.node = static_cast<int>(n);
          draw.object = caster;
          draw.plane = plane_index;
          draw.technique =
              technique == ShadowTechnique::walls ? ShadowTechnique::simple : technique;
          draw.kernels = options_.kernels.value_or(node.kernels);
          // One kernel for the whole object has no thickness to measure a light by.
          if (technique == ShadowTechnique::layered && draw.kernels != KernelSource::centroid) {
            draw.light_mode = options_.light_mode.value_or(node.light_mode);
          }
          draw.proxy = options_.proxies;
          draw.plane_frame = frame;
          draw.T_table_object = placement_of_model(caster);
          draw.constants = node.layered;
          draw.fractions = fractions;
          draw.tone_exponent = plan_.tone_exponent;
          draw.opacity = std::min(receiver.opacity, opacity_of_object(caster));
          plan_shadow(draw, plane);
        }
      }
      if (technique == ShadowTechnique::volume && !lights_of(static_cast<int>(n)).empty()) {
        plan_volumes(node, static_cast<int>(n), true);
      }
      if (options_.light_rays || node.light_rays) plan_rays(node, technique);
    }
    // All lights of a frame cast by one technique: a pixel in the shadow of one light by projection
    // and of another by a volume would lose their shares one after the other, not together. Volumes
    // fall on planes too.
    const bool volumes = !plan_.volumes.empty();
    if (volumes) plan_.hard_shadows.clear();
    for (std::size_t n = 0; n < scene_.shadows.size(); ++n) {
      const ShadowNode& node = scene_.shadows[n];
      const bool hard = options_.technique.value_or(node.technique) == ShadowTechnique::hard;
      if (hard && (volumes || !plan_.phantoms.empty())) {
        plan_volumes(node, static_cast<int>(n), volumes);
      }
    }
    plan_.volume_lights = static_cast<int>(volume_lights_.size());
    if (options_.skip) {
      std::erase_if(plan_.volumes,
                    [this](const ShadowVolumeDraw& draw) { return !volume_shows(draw); });
    }
  }

 private:
  void plan_shadow(ShadowDraw draw, const ScenePlane& plane) {
    const SceneObject& object = scene_.objects[static_cast<std::size_t>(draw.object)];
    if (!object.model || !object.casts_shadow) {
      skip(SkipReason::casts_no_shadow, draw.object);
      return;
    }
    if (draw.opacity <= 0.0F) return;  // the object itself is reported as skipped
    if (draw.technique == ShadowTechnique::simple) draw.umbra = draw.penumbra = false;
    const BoxCorners corners = box_corners(*object.model, draw.T_table_object);
    const Disc bounds =
        shadow_bounds(corners, draw, heights_above(draw.plane_frame, corners).second);
    draw.centre = bounds.centre;
    draw.radius = bounds.radius;
    // Kernels from a file may lie anywhere, and so may the layers.
    const bool bounded =
        draw.technique != ShadowTechnique::layered || !object.model->shadow_kernel_up;
    draw.off_outline = bounded && misses_outline(bounds, plane.outline);
    plan_receivers_under(draw, object);
    const ShadowDraw whole = draw;
    if (options_.skip && !something_to_see(draw, object)) {
      plan_.unseen_shadows.push_back(whole);
      return;
    }
    plan_.shadows.push_back(draw);
  }

  // Plans the shadow on receivers. At each height its layers differ from those on the plane, so
  // this is done whether or not it shows on the plane.
  void plan_receivers_under(const ShadowDraw& draw, const SceneObject& object) {
    if (scene_.objects.size() < 2) return;
    const BoxCorners corners = box_corners(*object.model, draw.T_table_object);
    ReceivedShadowDraw under;
    under.shadow = draw;
    under.top = heights_above(draw.plane_frame, corners).second;
    const Disc shadow = shadow_bounds(corners, draw, under.top);
    under.centre = shadow.centre;
    // Kernels from a file may lie anywhere, and so may the layers.
    const bool bounded =
        draw.technique != ShadowTechnique::layered || !object.model->shadow_kernel_up;
    under.radius = bounded ? shadow.radius : std::numeric_limits<double>::infinity();
    for (const OverPlane& receiver : receivers_over(draw.plane, draw.plane_frame)) {
      if (!are_one_thing(draw.object, receiver.object) && receiver.meets(under))
        ++plan_.meeting_pairs;
    }
    if (misses_all(under, plan_.phantoms)) skip(SkipReason::shadow_misses_phantoms, draw.object);
    if (misses_all(under, plan_.objects)) skip(SkipReason::shadow_misses_objects, draw.object);
  }

  // Returns the root of the virtual objects that an object belongs to. Children of a joint without
  // a model, or of a phantom, are roots.
  [[nodiscard]] int thing_of(int object) const {
    const auto parent_of = [this](int child) {
      return scene_.objects[static_cast<std::size_t>(child)].parent;
    };
    const auto is_virtual = [this](int parent) {
      const SceneObject& node = scene_.objects[static_cast<std::size_t>(parent)];
      return node.model && !node.phantom;
    };
    for (int parent = parent_of(object); parent >= 0 && is_virtual(parent);
         parent = parent_of(parent))
      object = parent;
    return object;
  }
  // Whether caster and receiver belong together, so that none shadows the other.
  [[nodiscard]] bool are_one_thing(int caster, int receiver) const {
    if (scene_.objects[static_cast<std::size_t>(receiver)].phantom) return receiver == caster;
    return thing_of(receiver) == thing_of(caster);
  }

  // An object's place over a plane.
  struct OverPlane {
    int object = 0;
    Disc disc;
    double low = 0.0, high = 0.0;  // [m]
    [[nodiscard]] bool meets(const ReceivedShadowDraw& under) const {
      return (under.centre - disc.centre).norm() <= under.radius + disc.radius && high > 0.0 &&
             under.top >= low;
    }
  };
  [[nodiscard]] OverPlane over_plane(int object, const PlaneFrame& plane) const {
    const auto at = static_cast<std::size_t>(object);
    const BoxCorners box = box_corners(*scene_.objects[at].model, placement_of_model(object));
    const auto [low, high] = heights_above(plane, box);
    return {object, footprint(box, plane), low, high};
  }
  // All receivers, in view or not.
  const std::vector<OverPlane>& receivers_over(int plane, const PlaneFrame& frame) {
    const auto [entry, is_new] = receivers_over_.try_emplace(plane);
    for (std::size_t i = 0; is_new && i < scene_.objects.size(); ++i) {
      const SceneObject& object = scene_.objects[i];
      const auto index = static_cast<int>(i);
      if (!object.model || opacity_of_object(index) <= 0.0F) continue;
      if (object.phantom || !all_blends(*object.model))
        entry->second.push_back(over_plane(index, frame));
    }
    return entry->second;
  }

  // Plans the shadow on those receivers that it may meet. Returns whether there are receivers, and
  // it meets none.
  bool misses_all(const ReceivedShadowDraw& under, const std::vector<ObjectDraw>& receivers) {
    bool asked = false;
    bool met = false;
    for (const ObjectDraw& receiver : receivers) {
      if (are_one_thing(under.shadow.object, receiver.object)) continue;
      const SceneObject& object = scene_.objects[static_cast<std::size_t>(receiver.object)];
      const Model& model = *object.model;
      if (options_.skip && !object.phantom && all_blends(model)) {
        skip(SkipReason::receiver_blends, receiver.object);
        continue;
      }
      asked = true;
      if (options_.skip && !over_plane(receiver.object, under.shadow.plane_frame).meets(under))
        continue;
      met = true;
      ReceivedShadowDraw draw = under;
      draw.receiver = receiver.object;
      draw.shadow.opacity = std::min(under.shadow.opacity, receiver.opacity);
      plan_.received_shadows.push_back(draw);
    }
    return asked && !met;
  }

  static std::vector<int> planes_of(const ShadowNode& node, ShadowTechnique technique) {
    std::vector<int> planes = node.planes;
    if (technique == ShadowTechnique::walls) {
      planes.insert(planes.end(), node.walls.begin(), node.walls.end());
    }
    return planes;
  }

  // Returns the lights that the node names, or the scene's first.
  std::vector<int> lights_of(int node_index) {
    const ShadowNode& node = scene_.shadows[static_cast<std::size_t>(node_index)];
    if (!node.lights.empty()) return node.lights;
    if (!scene_.lights.empty()) return {0};
    skip(SkipReason::no_light, node_index);
    return {};
  }

  void plan_hard_shadows(const ShadowNode& node, int node_index, const PlaneReceiver& receiver) {
    for (const int light : lights_of(node_index)) {
      const Eigen::Vector4d& place = plan_.lights[static_cast<std::size_t>(light)].place;
      // A light under the plane or the horizon reaches none of it.
      if (light_height(receiver.frame, place) <= 0.0) {
        skip(SkipReason::light_below_plane, light);
        continue;
      }
      std::set<int>& lights = lights_on_[receiver.plane];
      if (!lights.contains(light) && lights.size() == kMaxHardLights) {
        skip(SkipReason::too_many_lights, light);
        continue;
      }
      lights.insert(light);
      for (const int caster : node.casters) {
        const SceneObject& object = scene_.objects[static_cast<std::size_t>(caster)];
        if (!object.model || !object.casts_shadow) {
          skip(SkipReason::casts_no_shadow, caster);
          continue;
        }
        if (opacity_of_object(caster) <= 0.0F) continue;
        HardShadowDraw draw;
        draw.node = node_index;
        draw.object = caster;
        draw.plane = receiver.plane;
        draw.light = light;
        draw.plane_frame = receiver.frame;
        draw.T_table_object = placement_of_model(caster);
        draw.light_place = place;
        draw.proxy = options_.proxies;
        draw.opacity = std::min(receiver.opacity, opacity_of_object(caster));
        if (options_.skip && !hard_shadow_shows(draw, object)) continue;
        plan_.hard_shadows.push_back(draw);
      }
    }
  }

  void plan_volumes(const ShadowNode& node, int node_index, bool on_planes) {
    std::vector<int> lights = node.lights;
    if (lights.empty() && !scene_.lights.empty()) lights = {0};
    if (lights.empty() || node.planes.empty()) return;
    ShadowVolumeDraw draw;
    draw.node = node_index;
    draw.reach = kVolumeReach;
    for (const int index : node.planes) {
      const PlacedPlane placed = placed_plane(scene_, state_, index);
      const bool bounded = !scene_.planes[static_cast<std::size_t>(index)].outline.empty();
      if (!bounded && placed.opacity > 0.0) draw.floors.push_back(placed.frame);
    }
    std::vector<int> casters;
    for (const int caster : node.casters) {
      const SceneObject& object = scene_.objects[static_cast<std::size_t>(caster)];
      if (!object.model || !object.casts_shadow) {
        if (on_planes) skip(SkipReason::casts_no_shadow, caster);
      } else if (opacity_of_object(caster) > 0.0F) {
        casters.push_back(caster);
      }
    }
    draw.on_planes = on_planes;
    draw.proxy = options_.proxies;
    const std::vector<Ball> seen = on_planes ? std::vector<Ball>() : balls_about_phantoms();
    for (const int light : lights) {
      draw.light = light;
      draw.light_place = plan_.lights[static_cast<std::size_t>(light)].place;
      // A light that casts no projected shadow on any of the planes casts none on phantoms.
      const bool shown = std::ranges::any_of(node.planes, [&](int plane) {
        const auto lights_there = lights_on_.find(plane);
        return lights_there != lights_on_.end() && lights_there->second.contains(light);
      });
      if (!on_planes && !shown) continue;
      for (const int caster : casters) {
        draw.object = caster;
        draw.T_table_object = placement_of_model(caster);
        draw.receivers.clear();
        if (!on_planes) {
          // A volume made for other receivers has other triangles, whose edges may fall on other
          // pixels: receivers are the same with and without skipping.
          draw.receivers = balls_met(draw, seen);
          if (!draw.receivers.empty()) volume_lights_.insert(light);
          if (draw.receivers.empty() && options_.skip) {
            skip(SkipReason::shadow_misses_phantoms, caster);
          }
          if (draw.receivers.empty() && !options_.skip) draw.receivers = seen;
          if (draw.receivers.empty()) continue;
        }
        draw.opacity = opacity_of_object(caster);
        if (on_planes) volume_lights_.insert(light);
        add_volume(draw);
      }
    }
  }

  [[nodiscard]] Ball ball_about(const Model& model, const Placement& placement) const {
    const BoxCorners corners = box_corners(model, placement);
    const Eigen::Vector3d middle = 0.5 * (corners.front() + corners.back());
    return {middle, (corners.back() - middle).norm()};
  }

  // The phantoms that are in view.
  [[nodiscard]] std::vector<Ball> balls_about_phantoms() const {
    std::vector<Ball> balls;
    for (const ObjectDraw& phantom : plan_.phantoms) {
      const Model& model = *scene_.objects[static_cast<std::size_t>(phantom.object)].model;
      if (out_of_view(box_corners(model, phantom.T_table_object))) continue;
      balls.push_back(ball_about(model, phantom.T_table_object));
    }
    return balls;
  }

  // Returns the receivers that a caster may keep its light from.
  [[nodiscard]] std::vector<Ball> balls_met(const ShadowVolumeDraw& draw,
                                            const std::vector<Ball>& receivers) const {
    const SceneObject& object = scene_.objects[static_cast<std::size_t>(draw.object)];
    const Ball caster = ball_about(*casting_model(object, draw.proxy), draw.T_table_object);
    std::vector<Ball> met;
    for (const Ball& receiver : receivers) {
      if (may_shadow(draw.light_place, caster, receiver)) met.push_back(receiver);
    }
    return met;
  }

  // Adds a volume, or extends one that another node asked for to serve both: without a floor it
  // ends at kVolumeReach.
  void add_volume(const ShadowVolumeDraw& draw) {
    const auto known = std::ranges::find_if(plan_.volumes, [&draw](const ShadowVolumeDraw& other) {
      return other.object == draw.object && other.light == draw.light;
    });
    if (known == plan_.volumes.end()) {
      plan_.volumes.push_back(draw);
      return;
    }
    if (draw.floors.empty()) known->floors.clear();
    if (known->floors.empty()) return;
    for (const PlaneFrame& floor : draw.floors) {
      const bool there = std::ranges::any_of(known->floors, [&floor](const PlaneFrame& other) {
        return other.n == floor.n && other.q == floor.q;
      });
      if (!there) known->floors.push_back(floor);
    }
  }

  // Plans rays for the techniques whose shadows depend on a light; the others' fall along the
  // plane's normal.
  void plan_rays(const ShadowNode& node, ShadowTechnique technique) {
    if (technique != ShadowTechnique::hard && technique != ShadowTechnique::volume) return;
    std::vector<int> lights = node.lights;
    if (lights.empty() && !scene_.lights.empty()) lights = {0};
    std::vector<LightRayDraw::Plane> planes;
    for (const int index : node.planes) {
      const auto seen = std::ranges::find(plan_.receivers, index, &PlaneReceiver::plane);
      if (seen != plan_.receivers.end()) planes.push_back({index, seen->frame});
    }
    for (const int light : lights) {
      for (const int caster : node.casters) {
        const SceneObject& object = scene_.objects[static_cast<std::size_t>(caster)];
        const float opacity = opacity_of_object(caster);
        if (!object.model || !object.casts_shadow || opacity <= 0.0F) continue;
        const LightRayDraw draw{caster,
                                light,
                                placement_of_model(caster),
                                plan_.lights[static_cast<std::size_t>(light)].place,
                                planes,
                                options_.proxies,
                                opacity};
        if (options_.skip && !rays_show(draw, object)) continue;
        plan_.rays.push_back(draw);
      }
    }
  }

  // A volume for phantoms alone is planned only where it meets one.
  bool volume_shows(const ShadowVolumeDraw& draw) {
    if (!draw.on_planes) return true;
    const SceneObject& object = scene_.objects[static_cast<std::size_t>(draw.object)];
    const BoxCorners corners = box_corners(*casting_model(object, draw.proxy), draw.T_table_object);
    if (!out_of_view(hull_of_volume(corners, draw.light_place, draw.floors, draw.reach)))
      return true;
    skip(SkipReason::volume_out_of_view, draw.object);
    return false;
  }

  // Whether rays may be in view: they lie between the light, the caster and its box's images on the
  // planes. Where a light is not above the box, they may be.
  bool rays_show(const LightRayDraw& draw, const SceneObject& object) {
    const BoxCorners corners = box_corners(*casting_model(object, draw.proxy), draw.T_table_object);
    std::vector<Eigen::Vector3d> hull(corners.begin(), corners.end());
    if (draw.light_place.w() != 0.0) {
      hull.emplace_back(draw.light_place.head<3>() / draw.light_place.w());
    } else {
      for (const Eigen::Vector3d& corner : corners)
        hull.emplace_back(corner + kParallelRay * draw.light_place.head<3>().normalized());
    }
    for (const LightRayDraw::Plane& plane : draw.planes) {
      if (!(light_height(plane.frame, draw.light_place) > 0.0)) continue;
      const auto [bottom, top] = heights_above(plane.frame, corners);
      const HeightRange range = hard_shadow_range(plane.frame, draw.light_place);
      if (top < range.low || bottom > range.high) continue;
      if (top > range.high) return true;
      for (const Eigen::Vector3d& corner : corners) {
        const Eigen::Vector2d image =
            shadow_point(plane.frame, draw.light_place, plane.frame.to_plane(corner));
        hull.push_back(plane.frame.lift(image.x(), image.y()));
      }
    }
    if (!out_of_view(std::move(hull))) return true;
    skip(SkipReason::rays_out_of_view, draw.object);
    return false;
  }

  // Whether a hard shadow may be in view, by the image of the caster's box; it may be where the box
  // reaches under the plane or up to the light.
  bool hard_shadow_shows(const HardShadowDraw& draw, const SceneObject& object) {
    const ScenePlane& plane = scene_.planes[static_cast<std::size_t>(draw.plane)];
    const BoxCorners corners = box_corners(*casting_model(object, draw.proxy), draw.T_table_object);
    const auto [bottom, top] = heights_above(draw.plane_frame, corners);
    if (top < -kContactTolerance) {
      skip(SkipReason::shadow_below_plane, draw.object);
      return false;
    }
    const HeightRange range = hard_shadow_range(draw.plane_frame, draw.light_place);
    if (bottom > range.high) {
      skip(SkipReason::shadow_above_light, draw.object);
      return false;
    }
    if (bottom < -kContactTolerance || top > range.high) return true;
    std::array<Eigen::Vector3d, 8> image;
    std::array<Eigen::Vector2d, 8> flat;
    for (std::size_t i = 0; i < corners.size(); ++i) {
      const Eigen::Vector3d p = draw.plane_frame.to_plane(corners[i]);
      flat[i] = shadow_point(draw.plane_frame, draw.light_place, p);
      image[i] = T_camera_table_ * draw.plane_frame.lift(flat[i].x(), flat[i].y());
    }
    Eigen::Vector2d low = flat.front();
    Eigen::Vector2d high = flat.front();
    for (const Eigen::Vector2d& p : flat) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    if (misses_outline(low, high, plane.outline)) {
      skip(SkipReason::shadow_off_receiver, draw.object);
      return false;
    }
    if (frustum_.misses(image)) {
      skip(SkipReason::shadow_out_of_view, draw.object);
      return false;
    }
    return true;
  }

  // Drops layers that cannot show and returns whether any may. Conservative: the mesh lies inside
  // its box.
  bool something_to_see(ShadowDraw& draw, const SceneObject& object) {
    const BoxCorners corners = box_corners(*object.model, draw.T_table_object);
    const auto [bottom, top] = heights_above(draw.plane_frame, corners);
    if (top < -kContactTolerance) {
      skip(SkipReason::shadow_below_plane, draw.object);
      return false;
    }
    if (draw.technique != ShadowTechnique::simple) {
      // Under a light of one size each part keeps its umbra to a height of its own.
      const bool one_light =
          draw.technique == ShadowTechnique::field || draw.light_mode == LightMode::fixed;
      const auto above = [&](ShadowLayer layer) {
        return bottom >
               layer_height_range(draw.constants, one_light ? ShadowLayer::middle : layer).high +
                   kContactTolerance;
      };
      if (above(ShadowLayer::umbra)) {
        draw.umbra = false;
        if (!one_light) skip(SkipReason::umbra_vanished, draw.object);
      }
      if (above(ShadowLayer::middle)) draw.middle = false;
      if (above(ShadowLayer::penumbra)) draw.penumbra = false;
      if (!draw.umbra && !draw.middle && !draw.penumbra) {
        skip(SkipReason::shadow_above_light, draw.object);
        return false;
      }
    }
    if (draw.technique == ShadowTechnique::layered && object.model->shadow_kernel_up) return true;
    if (draw.off_outline) {
      skip(SkipReason::shadow_off_receiver, draw.object);
      return false;
    }
    std::array<Eigen::Vector3d, 4> square = draw.plane_frame.square_about(draw.centre, draw.radius);
    for (Eigen::Vector3d& corner : square) corner = T_camera_table_ * corner;
    if (frustum_.misses(square)) {
      skip(SkipReason::shadow_out_of_view, draw.object);
      return false;
    }
    return true;
  }

  [[nodiscard]] Placement placement_of_model(int object) const {
    const auto index = static_cast<std::size_t>(object);
    const std::shared_ptr<const Model>& model = scene_.objects[index].model;
    return model ? placed_model(*model, state_.objects[index]) : state_.objects[index];
  }

  [[nodiscard]] float opacity_of_object(int object) const {
    return std::min(plan_.overlay_opacity, static_cast<float>(opacity_of(state_, object)));
  }

  bool out_of_view(BoxCorners corners) const {
    for (Eigen::Vector3d& corner : corners) corner = T_camera_table_ * corner;
    return frustum_.misses(corners);
  }
  // Whether the hull of these points is out of view; an empty hull is unknown, and not.
  bool out_of_view(std::vector<Eigen::Vector3d> hull) const {
    for (Eigen::Vector3d& corner : hull) corner = T_camera_table_ * corner;
    return !hull.empty() && frustum_.misses(hull);
  }

  void skip(SkipReason reason, int subject) { plan_.skipped.push_back({reason, subject}); }

  static constexpr double kContactTolerance = 1e-6;  // [m]

  const Scene& scene_;
  const SceneState& state_;
  const PlanOptions& options_;
  FramePlan& plan_;
  std::map<int, std::set<int>> lights_on_;                // by plane: lights with hard shadows
  std::set<int> volume_lights_;                           // lights with volumes, in view or not
  std::map<int, std::vector<OverPlane>> receivers_over_;  // by plane
  ViewFrustum frustum_;
  Transform<frame::Camera, frame::Table> T_camera_table_;
};

}  // namespace

bool same_shapes(const ShadowDraw& a, const ShadowDraw& b) {
  return a.technique == b.technique && a.kernels == b.kernels && a.light_mode == b.light_mode &&
         a.proxy == b.proxy && a.plane_frame == b.plane_frame &&
         a.T_table_object == b.T_table_object && a.constants == b.constants;
}

const ObjectDraw* drawn_object(const FramePlan& plan, int object) {
  for (const std::vector<ObjectDraw>* draws : {&plan.phantoms, &plan.objects}) {
    const auto found = std::ranges::find(*draws, object, &ObjectDraw::object);
    if (found != draws->end()) return &*found;
  }
  return nullptr;
}

Lighting lighting_for(const Scene& scene, const SceneState& state) {
  // Cooler from above, warmer from wood and paper below.
  const Eigen::Vector3d sky_tint(1.08, 1.12, 1.18);
  const Eigen::Vector3d ground_tint(0.52, 0.49, 0.45);
  Lighting lighting;
  lighting.sky = scene.ambient.cwiseProduct(sky_tint);
  lighting.ground = scene.ambient.cwiseProduct(ground_tint);
  if (!state.video_light) return lighting;

  Eigen::Vector3d on_table = lighting.sky;
  const auto add = [&on_table](const PlacedLight& light) {
    const Eigen::Vector3d towards = light.place.head<3>();
    const double length = towards.norm();
    if (length > 0.0) on_table += std::max(towards.z() / length, 0.0) * light.color;
  };
  for (const PlacedLight& light : state.lights) add(light);
  if (state.lights.empty()) add(lamp_of_no_scene());
  lighting.gain = state.video_light->on_table / std::max(kLuminance.dot(on_table), 1.0);
  lighting.sky = lighting.sky.cwiseProduct(lighting.gain);
  lighting.ground = state.video_light->around;
  return lighting;
}

LightFractions lifted_by_ambient(const LightFractions& fractions, const Scene& scene,
                                 const std::vector<PlacedLight>& lights,
                                 const Eigen::Vector3d& normal, const Eigen::Vector3d& place) {
  const double ambient = kLuminance.dot(scene.ambient);
  if (!(ambient > Scene::kUsualAmbient)) return fractions;
  double direct = 0.0;
  const auto add = [&](const PlacedLight& light) {
    const Eigen::Vector3d towards = light.place.head<3>() - light.place.w() * place;
    const double length = towards.norm();
    if (length > 0.0)
      direct += std::max(towards.dot(normal) / length, 0.0) * kLuminance.dot(light.color);
  };
  for (const PlacedLight& light : lights) add(light);
  if (lights.empty()) add(lamp_of_no_scene());
  const double share = (Scene::kUsualAmbient + direct) / (ambient + direct);
  const auto lifted = [share](double left) { return 1.0 - share * (1.0 - left); };
  return {lifted(fractions.umbra), lifted(fractions.middle), lifted(fractions.penumbra)};
}

FramePlan plan_frame(const Scene& scene, const SceneState& state, const PoseEstimate& pose,
                     const CameraModel& camera, const PlanOptions& options) {
  PENUMBRA_ASSERT(state.objects.size() == scene.objects.size());
  PENUMBRA_ASSERT(state.lights.size() == scene.lights.size());
  FramePlan plan;
  plan.reuse = options.skip;
  if (!pose.has_pose() || !pose.T_table_camera.is_finite()) {
    plan.skipped.push_back(
        {SkipReason::no_pose, -1, -1, pose.reason.empty() ? "no pose" : pose.reason});
    return plan;
  }
  plan.whole_masks = !options.skip;
  plan.translucency = options.translucency;
  plan.layers = options.layers;
  plan.overlay_opacity = static_cast<float>(opacity_for(pose.status, pose.held_from, pose.age_s));
  if (plan.overlay_opacity <= 0.0F) {
    plan.skipped.push_back({SkipReason::faded_out});
    return plan;
  }
  plan.has_pose = true;
  plan.T_table_camera = pose.T_table_camera;
  plan.lights = state.lights;
  plan.lighting = lighting_for(scene, state);
  plan.tone_exponent = camera.parameters().tone_curve.value_or(kUsualToneExponent);
  Planner planner(scene, state, camera, options, plan);
  planner.plan_objects();
  planner.plan_shadows();
  return plan;
}

}  // namespace penumbra
