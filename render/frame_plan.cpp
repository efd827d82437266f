#include "render/frame_plan.hpp"

#include <algorithm>
#include <limits>
#include <map>
#include <set>
#include <utility>

#include "core/assert.hpp"
#include "render/bounds.hpp"
#include "render/camera_gl.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/fields/contact_shade.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/projected/light_rays.hpp"
#include "render/shadow/projected/projected_shadow.hpp"

namespace penumbra {
namespace {

constexpr double kContactTolerance_m = 1e-6;

// Returns a disc that contains every layer. A kernel k lies inside the footprint's bounding circle
// of radius r. The layer factor s projects a vertex x to k + s (x - k), within s r + (s - 1) r of
// the centre. 5 % are added for kernels one raster cell outside.
Disc shadow_bounds(const BoxCorners& corners, const ShadowDraw& draw, double top) {
  Disc disc = footprint(corners, draw.plane_frame);
  double s = 1.0;
  // A field's light stands at height H above the middle of a part, with a radius of up to a r. With
  // t = h / (H - h), a point at height h is projected to within r + 2 t r + a t r < (2 s - 1) r.
  if (traits_of(draw.technique).has_penumbra) {
    for (const ShadowLayer layer : {ShadowLayer::umbra, ShadowLayer::penumbra}) {
      const HeightRange range = layer_height_range(draw.constants, layer);
      s = std::max(s, layer_factor(draw.constants, layer, std::clamp(top, range.low, range.high)));
    }
  }
  // For a fixed light 2 becomes 2.5, because the light's disc may be as small as a raster cell.
  const double reach = draw.light_mode == LightMode::fixed ? 2.5 : 2.0;
  disc.radius *= 1.05 * (reach * s - 1.0);
  return disc;
}

// Returns true if a box on the plane is outside the outline's bounds. Empty outline: unbounded.
bool misses_outline(const Eigen::AlignedBox2d& box, const std::vector<Eigen::Vector2d>& outline) {
  Eigen::AlignedBox2d bounds;
  for (const Eigen::Vector2d& p : outline) bounds.extend(p);
  if (outline.empty()) return false;
  return ((bounds.min().array() > box.max().array()) || (bounds.max().array() < box.min().array()))
      .any();
}

// Returns true if shadow_bounds() contains the layers, which is unknown for kernels from a file.
bool is_bounded(const ShadowDraw& draw, const Model& model) {
  return !traits_of(draw.technique).uses_kernels || !model.shadow_kernel_up;
}

// Adds the shapes of objects with an animation to the plan. Returns them by object; empty if there
// are none.
std::vector<const Model*> pose_models(const Scene& scene, const SceneState& state,
                                      FramePlan& plan) {
  std::vector<const Model*> posed;
  for (std::size_t i = 0; i < state.poses.size(); ++i) {
    if (!scene.objects[i].playback.model) continue;
    const auto object = static_cast<int>(i);
    bool is_missing = false;
    plan.posed.push_back({object, shape_of(scene, state, object, &is_missing)});
    if (is_missing) plan.skipped.push_back({SkipReason::shape_missing, object});
    posed.resize(scene.objects.size(), nullptr);
    posed[i] = plan.posed.back().model.get();
  }
  return posed;
}

class Planner {
 public:
  Planner(const Scene& scene, const SceneState& state, const CameraModel& camera,
          const PlanOptions& options, FramePlan& plan)
      : scene_(scene),
        state_(state),
        options_(options),
        plan_(plan),
        posed_(pose_models(scene, state, plan)),
        frustum_(make_frustum(camera)),
        T_camera_table_(plan.T_table_camera.inverse()) {}

  void plan_objects() {
    for (std::size_t i = 0; i < scene_.objects.size(); ++i) {
      const SceneObject& object = scene_.objects[i];
      if (!object.model || object.removed) continue;  // without a model: a node of the hierarchy
      const auto index = static_cast<int>(i);
      const ObjectDraw draw{index, placement_of_model(index), opacity_of_object(index),
                            pose_of(state_, index)};
      if (draw.opacity <= 0.0F) {
        skip(SkipReason::object_group_not_seen, index);
        continue;
      }
      if (options_.skip && out_of_view(box_corners(model_of(index), draw.T_table_object))) {
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
        add_receiver(receiver, technique == ShadowTechnique::walls);
        const bool is_wall = std::ranges::find(node.planes, plane_index) == node.planes.end();
        if (node.contact && !is_wall) plan_contacts(node, receiver);
        switch (technique) {
          case ShadowTechnique::simple:
          case ShadowTechnique::layered:
          case ShadowTechnique::field:
          case ShadowTechnique::walls:
            plan_layers(node, static_cast<int>(n), technique, receiver);
            break;
          case ShadowTechnique::hard:
            plan_hard_shadows(node, static_cast<int>(n), receiver);
            break;
          case ShadowTechnique::volume:  // see below: once for all planes
          case ShadowTechnique::none:
            break;
        }
      }
      if (technique == ShadowTechnique::volume) {
        if (lights_of(node).empty()) skip(SkipReason::no_light, static_cast<int>(n));
        plan_volumes(node, true);
      }
      if (options_.light_rays || node.light_rays) plan_rays(node, technique);
    }
    // All lights of a frame use one technique. Otherwise a pixel in one light's projected shadow
    // and another's volume would be darkened twice in turn instead of by their sum.
    const bool volumes = !plan_.volumes.empty();
    if (volumes) plan_.hard_shadows.clear();
    for (std::size_t n = 0; n < scene_.shadows.size(); ++n) {
      const ShadowNode& node = scene_.shadows[n];
      const bool hard = options_.technique.value_or(node.technique) == ShadowTechnique::hard;
      if (hard && (volumes || !plan_.phantoms.empty())) {
        plan_volumes(node, volumes);
      }
    }
    plan_.volume_lights = static_cast<int>(volume_lights_.size());
    if (options_.skip) {
      std::erase_if(plan_.volumes,
                    [this](const ShadowVolumeDraw& draw) { return !volume_may_show(draw); });
    }
  }

 private:
  [[nodiscard]] const SceneObject& object_at(int object) const {
    return scene_.objects[static_cast<std::size_t>(object)];
  }

  // Returns the shape of an object that has a model.
  [[nodiscard]] const Model& model_of(int object) const {
    const auto index = static_cast<std::size_t>(object);
    return index < posed_.size() && posed_[index] != nullptr ? *posed_[index]
                                                             : *scene_.objects[index].model;
  }
  [[nodiscard]] const Model& casting_model_of(const LitCaster& caster) const {
    const SceneObject& object = object_at(caster.object);
    return object.playback.model ? model_of(caster.object) : *casting_model(object, caster.proxy);
  }

  // Returns true if an object casts shadows at this time. `report`: records why it never does.
  bool casts(int object, bool report = true) {
    if (object_at(object).model && object_at(object).casts_shadow)
      return opacity_of_object(object) > 0.0F;
    return report && skip(SkipReason::casts_no_shadow, object);
  }

  void plan_layers(const ShadowNode& node, int node_index, ShadowTechnique technique,
                   const PlaneReceiver& receiver) {
    const LightFractions fractions = lifted_by_ambient(node.fractions, scene_, state_.lights,
                                                       receiver.frame.n, receiver.frame.q);
    for (const int caster : node.casters) {
      ShadowDraw draw;
      draw.node = node_index;
      draw.object = caster;
      draw.plane = receiver.plane;
      draw.technique = technique == ShadowTechnique::walls ? ShadowTechnique::simple : technique;
      // docs/shadows.md#kernels-of-animated-models
      draw.may_carry_kernels =
          technique == ShadowTechnique::layered && object_at(caster).playback.model != nullptr;
      if (draw.may_carry_kernels) draw.technique = ShadowTechnique::field;
      draw.kernels = options_.kernels.value_or(node.kernels);
      // A proportional light needs each part's thickness; one kernel per object has none.
      if (traits_of(technique).uses_kernels && draw.kernels != KernelSource::centroid) {
        draw.light_mode = options_.light_mode.value_or(node.light_mode);
      }
      draw.proxy = options_.proxies;
      draw.plane_frame = receiver.frame;
      draw.T_table_object = placement_of_model(caster);
      draw.pose_s = pose_of(state_, caster);
      draw.constants = node.layered;
      draw.fractions = fractions;
      draw.tone_exponent = plan_.tone_exponent;
      draw.opacity = std::min(receiver.opacity, opacity_of_object(caster));
      plan_shadow(draw);
    }
  }

  void plan_shadow(ShadowDraw draw) {
    if (!casts(draw.object)) return;
    const Model& model = model_of(draw.object);
    if (!traits_of(draw.technique).has_penumbra) draw.umbra = draw.penumbra = false;
    const BoxCorners corners = box_corners(model, draw.T_table_object);
    const HeightRange heights = heights_above(draw.plane_frame, corners);
    const Disc bounds = shadow_bounds(corners, draw, heights.high);
    draw.centre = bounds.centre;
    draw.radius = bounds.radius;
    draw.off_outline = is_bounded(draw, model) &&
                       misses_outline({bounds.centre.array() - bounds.radius,
                                       bounds.centre.array() + bounds.radius},
                                      scene_.planes[static_cast<std::size_t>(draw.plane)].outline);
    plan_on_receivers(draw, model, heights.high);
    const ShadowDraw all_layers = draw;
    if (options_.skip && !drop_invisible_layers(draw, model, heights)) {
      plan_.skipped_shadows.push_back(all_layers);
      return;
    }
    plan_.shadows.push_back(draw);
  }

  // Plans the shadow on receivers. Layers that are invisible on the plane may be visible higher up.
  void plan_on_receivers(const ShadowDraw& draw, const Model& model, double top) {
    if (scene_.objects.size() < 2) return;
    ReceivedShadowDraw cast;
    cast.shadow = draw;
    cast.top = top;
    cast.radius = is_bounded(draw, model) ? draw.radius : std::numeric_limits<double>::infinity();
    for (const ReceiverBounds& receiver : all_receiver_bounds(draw.plane, draw.plane_frame)) {
      if (!belong_together(draw.object, receiver.object) && receiver.meets(cast))
        ++plan_.caster_receiver_pairs;
    }
    if (plan_in_reach(cast, plan_.phantoms)) skip(SkipReason::shadow_misses_phantoms, draw.object);
    if (plan_in_reach(cast, plan_.objects)) skip(SkipReason::shadow_misses_objects, draw.object);
  }

  // Returns the root of the connected virtual objects that an object belongs to. Children of a
  // phantom, or of an object without a model, are roots.
  [[nodiscard]] int root_object_of(int object) const {
    for (int parent = object_at(object).parent;
         parent >= 0 && object_at(parent).model && !object_at(parent).phantom;
         parent = object_at(parent).parent)
      object = parent;
    return object;
  }
  // Returns true if caster and receiver belong together, so that neither shadows the other.
  [[nodiscard]] bool belong_together(int caster, int receiver) const {
    if (object_at(receiver).phantom) return receiver == caster;
    return root_object_of(receiver) == root_object_of(caster);
  }

  struct ReceiverBounds {
    int object = 0;
    Disc disc;
    HeightRange heights;  // [m]
    [[nodiscard]] bool meets(const ReceivedShadowDraw& cast) const {
      return (cast.shadow.centre - disc.centre).norm() <= cast.radius + disc.radius &&
             heights.high > 0.0 && cast.top >= heights.low;
    }
  };
  [[nodiscard]] ReceiverBounds receiver_bounds(int object, const PlaneFrame& plane) const {
    const BoxCorners box = box_corners(model_of(object), placement_of_model(object));
    return {object, footprint(box, plane), heights_above(plane, box)};
  }
  // Returns the bounds of all receivers, in view or not.
  const std::vector<ReceiverBounds>& all_receiver_bounds(int plane, const PlaneFrame& frame) {
    const auto [entry, is_new] = receiver_bounds_.try_emplace(plane);
    for (std::size_t i = 0; is_new && i < scene_.objects.size(); ++i) {
      const SceneObject& object = scene_.objects[i];
      const auto index = static_cast<int>(i);
      if (!object.model || opacity_of_object(index) <= 0.0F) continue;
      if (object.phantom || !all_blends(model_of(index)))
        entry->second.push_back(receiver_bounds(index, frame));
    }
    return entry->second;
  }

  // Plans the shadow on receivers in reach. Returns true if there are receivers, but none in reach.
  bool plan_in_reach(const ReceivedShadowDraw& cast, const std::vector<ObjectDraw>& receivers) {
    bool has_receivers = false;
    bool reaches_any = false;
    for (const ObjectDraw& receiver : receivers) {
      if (belong_together(cast.shadow.object, receiver.object)) continue;
      const SceneObject& object = object_at(receiver.object);
      if (options_.skip && !object.phantom && all_blends(model_of(receiver.object))) {
        skip(SkipReason::receiver_blends, receiver.object);
        continue;
      }
      has_receivers = true;
      if (options_.skip && !receiver_bounds(receiver.object, cast.shadow.plane_frame).meets(cast))
        continue;
      reaches_any = true;
      ReceivedShadowDraw draw = cast;
      draw.receiver = receiver.object;
      draw.shadow.opacity = std::min(cast.shadow.opacity, receiver.opacity);
      plan_.received_shadows.push_back(draw);
    }
    return has_receivers && !reaches_any;
  }

  // Plans the contact shades of the virtual objects that are near the plane.
  void plan_contacts(const ShadowNode& node, const PlaneReceiver& receiver) {
    const std::vector<Eigen::Vector2d>& outline =
        scene_.planes[static_cast<std::size_t>(receiver.plane)].outline;
    for (const int caster : node.casters) {
      if (!casts(caster, false) || object_at(caster).phantom) continue;
      const Model& model = model_of(caster);
      ContactDraw draw{caster, receiver.plane, receiver.frame, placement_of_model(caster),
                       pose_of(state_, caster)};
      const double diagonal = (to_eigen(model.max_corner) - to_eigen(model.min_corner)).norm();
      draw.reach = contact_reach(diagonal * draw.T_table_object.scale);
      draw.opacity = std::min(receiver.opacity, opacity_of_object(caster));
      const BoxCorners corners = box_corners(model, draw.T_table_object);
      const HeightRange heights = heights_above(receiver.frame, corners);
      if (heights.low >= draw.reach || heights.high < 0.0) continue;
      const bool known = std::ranges::any_of(plan_.contacts, [&](const ContactDraw& other) {
        return other.object == draw.object && other.plane == draw.plane;
      });
      if (known) continue;
      Disc disc = footprint(corners, receiver.frame);
      disc.radius += draw.reach;
      const bool is_seen =
          !out_of_view(receiver.frame.square_about(disc.centre, disc.radius)) &&
          !misses_outline({disc.centre.array() - disc.radius, disc.centre.array() + disc.radius},
                          outline);
      if (is_seen || !options_.skip) plan_.contacts.push_back(draw);
    }
  }

  // `walls`: of the technique `walls`. A wall without an outline, with a tag group, or on which
  // other techniques cast shadows, is a real one.
  void add_receiver(const PlaneReceiver& receiver, bool walls) {
    auto known = std::ranges::find(plan_.receivers, receiver.plane, &PlaneReceiver::plane);
    if (known == plan_.receivers.end()) known = plan_.receivers.insert(known, receiver);
    if (!walls || !options_.walls) return;
    const ScenePlane& plane = scene_.planes[static_cast<std::size_t>(receiver.plane)];
    known->virtual_wall =
        !plane.outline.empty() && plane.tag_group == kTableGroup &&
        std::ranges::none_of(scene_.shadows, [&receiver](const ShadowNode& node) {
          return std::ranges::find(node.planes, receiver.plane) != node.planes.end();
        });
  }

  static std::vector<int> planes_of(const ShadowNode& node, ShadowTechnique technique) {
    std::vector<int> planes = node.planes;
    if (technique == ShadowTechnique::walls)
      planes.insert(planes.end(), node.walls.begin(), node.walls.end());
    return planes;
  }

  // Returns the node's lights, or the scene's first light if the node has none.
  [[nodiscard]] std::vector<int> lights_of(const ShadowNode& node) const {
    if (!node.lights.empty() || scene_.lights.empty()) return node.lights;
    return {0};
  }

  [[nodiscard]] const Eigen::Vector4d& light_position_of(int light) const {
    return plan_.lights[static_cast<std::size_t>(light)].position;
  }
  [[nodiscard]] LitCaster lit_caster(int object, int light) const {
    return {object,
            light,
            placement_of_model(object),
            light_position_of(light),
            options_.proxies,
            opacity_of_object(object),
            pose_of(state_, object)};
  }

  void plan_hard_shadows(const ShadowNode& node, int node_index, const PlaneReceiver& receiver) {
    const std::vector<int> node_lights = lights_of(node);
    if (node_lights.empty()) skip(SkipReason::no_light, node_index);
    for (const int light : node_lights) {
      // A light below the plane or the horizon does not reach it.
      if (light_height(receiver.frame, light_position_of(light)) <= 0.0) {
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
        if (!casts(caster)) continue;
        HardShadowDraw draw{lit_caster(caster, light), receiver.plane, receiver.frame};
        draw.opacity = std::min(receiver.opacity, draw.opacity);
        if (options_.skip && !hard_shadow_may_show(draw)) continue;
        plan_.hard_shadows.push_back(draw);
      }
    }
  }

  // `on_planes`: plans volumes that darken all surfaces; false: only visible phantoms.
  void plan_volumes(const ShadowNode& node, bool on_planes) {
    const std::vector<int> lights = lights_of(node);
    if (lights.empty() || node.planes.empty()) return;
    std::vector<PlaneFrame> floors;
    for (const int index : node.planes) {
      const PlacedPlane placed = placed_plane(scene_, state_, index);
      const bool bounded = !scene_.planes[static_cast<std::size_t>(index)].outline.empty();
      if (!bounded && placed.opacity > 0.0) floors.push_back(placed.frame);
    }
    std::vector<int> casters;
    for (const int caster : node.casters) {
      if (casts(caster, on_planes)) casters.push_back(caster);
    }
    const std::vector<BoundingSphere> visible_phantoms =
        on_planes ? std::vector<BoundingSphere>() : spheres_about_phantoms();
    for (const int light : lights) {
      // A light without a projected shadow on any plane casts none on phantoms either.
      const bool shown = std::ranges::any_of(node.planes, [&](int plane) {
        const auto lights_there = lights_on_.find(plane);
        return lights_there != lights_on_.end() && lights_there->second.contains(light);
      });
      if (!on_planes && !shown) continue;
      for (const int caster : casters) {
        ShadowVolumeDraw draw{lit_caster(caster, light), floors, on_planes, {}};
        if (!on_planes) draw.receivers = spheres_reached(draw, visible_phantoms);
        if (on_planes || !draw.receivers.empty()) {
          volume_lights_.insert(light);
        } else if (options_.skip) {
          skip(SkipReason::shadow_misses_phantoms, caster);
          continue;
        } else {
          // The receivers affect the triangles and thus the pixels at their edges, so a volume that
          // reaches a receiver has the same receivers with and without skipping.
          draw.receivers = visible_phantoms;
          if (visible_phantoms.empty()) continue;
        }
        add_volume(draw);
      }
    }
  }

  [[nodiscard]] BoundingSphere sphere_about(const Model& model, const Placement& placement) const {
    const BoxCorners corners = box_corners(model, placement);
    const Eigen::Vector3d middle = 0.5 * (corners.front() + corners.back());
    return {middle, (corners.back() - middle).norm()};
  }

  [[nodiscard]] std::vector<BoundingSphere> spheres_about_phantoms() const {
    std::vector<BoundingSphere> spheres;
    for (const ObjectDraw& phantom : plan_.phantoms) {
      const Model& model = model_of(phantom.object);
      if (out_of_view(box_corners(model, phantom.T_table_object))) continue;
      spheres.push_back(sphere_about(model, phantom.T_table_object));
    }
    return spheres;
  }

  // Returns the receivers that a caster may shadow.
  [[nodiscard]] std::vector<BoundingSphere> spheres_reached(
      const ShadowVolumeDraw& draw, const std::vector<BoundingSphere>& receivers) const {
    const BoundingSphere caster = sphere_about(casting_model_of(draw), draw.T_table_object);
    std::vector<BoundingSphere> reached;
    for (const BoundingSphere& receiver : receivers) {
      if (may_shadow(draw.light_position, caster, receiver)) reached.push_back(receiver);
    }
    return reached;
  }

  // Adds a volume, or extends the same volume of another node. Volumes without floors end at
  // kVolumeReach.
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
      const bool is_known = std::ranges::any_of(known->floors, [&floor](const PlaneFrame& other) {
        return other.n == floor.n && other.q == floor.q;
      });
      if (!is_known) known->floors.push_back(floor);
    }
  }

  // Plans rays for the techniques whose shadows depend on a light.
  void plan_rays(const ShadowNode& node, ShadowTechnique technique) {
    if (!traits_of(technique).uses_lights) return;
    std::vector<LightRayDraw::Plane> planes;
    for (const int index : node.planes) {
      const auto seen = std::ranges::find(plan_.receivers, index, &PlaneReceiver::plane);
      if (seen != plan_.receivers.end()) planes.push_back({index, seen->frame});
    }
    for (const int light : lights_of(node)) {
      for (const int caster : node.casters) {
        if (!casts(caster, false)) continue;
        const LightRayDraw draw{lit_caster(caster, light), planes};
        if (options_.skip && !rays_may_show(draw)) continue;
        plan_.rays.push_back(draw);
      }
    }
  }

  [[nodiscard]] BoxCorners casting_box(const LitCaster& caster) const {
    return box_corners(casting_model_of(caster), caster.T_table_object);
  }

  // Returns true if a volume may be in view, or if it is for phantoms alone and thus reaches one.
  bool volume_may_show(const ShadowVolumeDraw& draw) {
    if (!draw.on_planes || !out_of_view(hull_of_volume(casting_box(draw), draw.light_position,
                                                       draw.floors, kVolumeReach)))
      return true;
    return skip(SkipReason::volume_out_of_view, draw.object);
  }

  // Returns true if rays may be in view. They lie in the hull of the light, the caster's box and
  // its projections onto the planes; if the light is not above the box, returns true.
  bool rays_may_show(const LightRayDraw& draw) {
    const BoxCorners corners = casting_box(draw);
    std::vector<Eigen::Vector3d> hull(corners.begin(), corners.end());
    if (draw.light_position.w() != 0.0) {
      hull.emplace_back(draw.light_position.head<3>() / draw.light_position.w());
    } else {
      for (const Eigen::Vector3d& corner : corners)
        hull.emplace_back(corner + kRayLength_m * draw.light_position.head<3>().normalized());
    }
    for (const LightRayDraw::Plane& plane : draw.planes) {
      if (!(light_height(plane.frame, draw.light_position) > 0.0)) continue;
      const HeightRange heights = heights_above(plane.frame, corners);
      const HeightRange range = hard_shadow_range(plane.frame, draw.light_position);
      if (heights.high < range.low || heights.low > range.high) continue;
      if (heights.high > range.high) return true;
      for (const Eigen::Vector3d& corner : corners) {
        const Eigen::Vector2d projected =
            shadow_point(plane.frame, draw.light_position, plane.frame.to_plane(corner));
        hull.push_back(plane.frame.lift(projected.x(), projected.y()));
      }
    }
    return !out_of_view(std::move(hull)) || skip(SkipReason::rays_out_of_view, draw.object);
  }

  // Returns true if a hard shadow may be in view, judged by the projection of the caster's box.
  // Returns true for a box that extends below the plane or up to the light.
  bool hard_shadow_may_show(const HardShadowDraw& draw) {
    const BoxCorners corners = casting_box(draw);
    const HeightRange heights = heights_above(draw.plane_frame, corners);
    if (heights.high < -kContactTolerance_m)
      return skip(SkipReason::shadow_below_plane, draw.object);
    const HeightRange range = hard_shadow_range(draw.plane_frame, draw.light_position);
    if (heights.low > range.high) return skip(SkipReason::shadow_above_light, draw.object);
    if (heights.low < -kContactTolerance_m || heights.high > range.high) return true;
    BoxCorners projected;
    Eigen::AlignedBox2d bounds;
    for (std::size_t i = 0; i < corners.size(); ++i) {
      const Eigen::Vector2d p = shadow_point(draw.plane_frame, draw.light_position,
                                             draw.plane_frame.to_plane(corners[i]));
      bounds.extend(p);
      projected[i] = draw.plane_frame.lift(p.x(), p.y());
    }
    if (misses_outline(bounds, scene_.planes[static_cast<std::size_t>(draw.plane)].outline))
      return skip(SkipReason::shadow_off_receiver, draw.object);
    return !out_of_view(projected) || skip(SkipReason::shadow_out_of_view, draw.object);
  }

  // Drops layers that are certainly invisible; returns true if any may be visible. Conservative, as
  // it tests the mesh's box.
  bool drop_invisible_layers(ShadowDraw& draw, const Model& model, const HeightRange& heights) {
    if (heights.high < -kContactTolerance_m)
      return skip(SkipReason::shadow_below_plane, draw.object);
    if (traits_of(draw.technique).has_penumbra) {
      // If the light has one size for all parts, each part loses its umbra at its own height.
      const bool one_light = has_one_light_size(draw);
      const auto above = [&](ShadowLayer layer) {
        return heights.low >
               layer_height_range(draw.constants, one_light ? ShadowLayer::middle : layer).high +
                   kContactTolerance_m;
      };
      if (above(ShadowLayer::umbra)) {
        draw.umbra = false;
        if (!one_light) skip(SkipReason::umbra_vanished, draw.object);
      }
      if (above(ShadowLayer::middle)) draw.middle = false;
      if (above(ShadowLayer::penumbra)) draw.penumbra = false;
      if (!draw.umbra && !draw.middle && !draw.penumbra)
        return skip(SkipReason::shadow_above_light, draw.object);
    }
    if (!is_bounded(draw, model)) return true;
    if (draw.off_outline) return skip(SkipReason::shadow_off_receiver, draw.object);
    return !out_of_view(draw.plane_frame.square_about(draw.centre, draw.radius)) ||
           skip(SkipReason::shadow_out_of_view, draw.object);
  }

  [[nodiscard]] Placement placement_of_model(int object) const {
    const Placement& placement = state_.objects[static_cast<std::size_t>(object)];
    return object_at(object).model ? placed_model(model_of(object), placement) : placement;
  }

  [[nodiscard]] float opacity_of_object(int object) const {
    return std::min(plan_.overlay_opacity, static_cast<float>(opacity_of(state_, object)));
  }

  // Returns true if the convex hull of the points (table frame) is out of view. An empty hull is
  // unknown and returns false.
  template <class Points>
  [[nodiscard]] bool out_of_view(Points hull) const {
    for (Eigen::Vector3d& corner : hull) corner = T_camera_table_ * corner;
    return !hull.empty() && frustum_.misses(hull);
  }

  // Records the reason and returns false.
  bool skip(SkipReason reason, int subject) {
    plan_.skipped.push_back({reason, subject});
    return false;
  }

  const Scene& scene_;
  const SceneState& state_;
  const PlanOptions& options_;
  FramePlan& plan_;
  std::vector<const Model*> posed_;  // by object: the shape of an animation, or null; may be empty
  std::map<int, std::set<int>> lights_on_;  // by plane: lights with hard shadows
  std::set<int> volume_lights_;             // all lights with volumes, in view or not
  std::map<int, std::vector<ReceiverBounds>> receiver_bounds_;  // by plane
  ViewFrustum frustum_;
  Transform<frame::Camera, frame::Table> T_camera_table_;
};

}  // namespace

bool has_one_light_size(const ShadowShape& shadow) {
  return traits_of(shadow.technique).has_one_light_size || shadow.light_mode == LightMode::fixed;
}

const ObjectDraw* drawn_object(const FramePlan& plan, int object) {
  for (const std::vector<ObjectDraw>* draws : {&plan.phantoms, &plan.objects}) {
    const auto found = std::ranges::find(*draws, object, &ObjectDraw::object);
    if (found != draws->end()) return &*found;
  }
  return nullptr;
}

FramePlan plan_frame(const Scene& scene, const SceneState& state, const PoseEstimate& pose,
                     const CameraModel& camera, const PlanOptions& options) {
  PENUMBRA_ASSERT(state.objects.size() == scene.objects.size());
  PENUMBRA_ASSERT(state.lights.size() == scene.lights.size());
  FramePlan plan;
  plan.reuse = options.skip;
  plan.translucency = options.translucency;
  if (!pose.has_pose() || !pose.T_table_camera.is_finite()) {
    plan.skipped.push_back({SkipReason::no_pose});
    return plan;
  }
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
  plan.tone_exponent = camera.parameters().tone_curve.value_or(kDefaultToneExponent);
  Planner planner(scene, state, camera, options, plan);
  planner.plan_objects();
  planner.plan_shadows();
  return plan;
}

}  // namespace penumbra
