// Decides what one frame draws, before any GL call. Equal scene, pose and options give equal plans.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "render/lighting.hpp"
#include "render/render_work.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/volumes/shadow_volume.hpp"
#include "render/translucency.hpp"

namespace penumbra {

// Gamma exponent of a camera with unknown response: encoded = linear ^ (1 / exponent), close to
// sRGB (docs/rendering.md#tone).
inline constexpr double kDefaultToneExponent = 2.2;

struct PlanOptions {
  Translucency translucency = Translucency::automatic;
  std::optional<ShadowTechnique> technique;  // overrides every shadow node's
  std::optional<KernelSource> kernels;       // overrides every shadow node's
  std::optional<LightMode> light_mode;       // overrides every shadow node's
  bool proxies = true;                       // false: every object casts with its own mesh
  LayerDrawing layers = LayerDrawing::automatic;
  bool light_rays = false;  // for every shadow node
  bool walls = true;        // draws the virtual walls of the technique `walls`
  // Skips invisible draws and reuses results of earlier frames. Does not change the image.
  bool skip = true;
};

struct ObjectDraw {
  int object = 0;  // index into Scene::objects
  Placement T_table_object;
  float opacity = 1.0F;  // at most the overlay's opacity
  double pose_s = 0.0;   // see PosedModel
};

// The shape of an object with an animation in this frame. In all draws of an object, equal `pose_s`
// mean equal shapes.
struct PosedModel {
  int object = 0;  // index into Scene::objects
  std::shared_ptr<const Model> model;
};

// A shadow-receiving plane whose front faces the eye. It hides the planes behind it.
struct PlaneReceiver {
  int plane = 0;  // index into Scene::planes
  PlaneFrame frame;
  float opacity = 1.0F;       // opacity of its shadows; at most the overlay's opacity
  bool virtual_wall = false;  // drawn as a pane (wall_pass.hpp)
};

// All inputs of the shape of a caster's layers on a plane, without their darkness and visibility.
struct ShadowShape {
  ShadowTechnique technique = ShadowTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
  LightMode light_mode = LightMode::proportional;
  // The layered shadow of an object with an animation. It is planned as a field; the compositor
  // makes it layered if carried kernels suit it (CasterCache::carries_kernels()).
  bool may_carry_kernels = false;
  bool proxy = true;  // a reduced mesh may cast, if the object allows it
  PlaneFrame plane_frame;
  Placement T_table_object;
  double pose_s = 0.0;  // see PosedModel
  LayeredConstants constants;
  friend bool operator==(const ShadowShape&, const ShadowShape&) = default;
};

// Returns true if the light has the same size for all parts, so that each part loses its umbra at
// its own height.
[[nodiscard]] bool has_one_light_size(const ShadowShape& shadow);

// One caster's layered, field or simple shadow on one plane. Shadows of `walls` are simple.
struct ShadowDraw : ShadowShape {
  int node = 0, object = 0, plane = 0;                // indices into the scene
  LightFractions fractions;                           // the scene's, lifted by its ambient light
  double tone_exponent = kDefaultToneExponent;        // FramePlan::tone_exponent
  bool umbra = true, middle = true, penumbra = true;  // which layers are not empty
  bool off_outline = false;                           // the disc is outside the plane's outline
  float opacity = 1.0F;                               // minimum of the caster's and the plane's
  // A disc on the plane that contains every layer [m]; not valid for kernels from a file.
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0.0;
};

// The contact shade of an object on a plane.
struct ContactDraw {
  int object = 0, plane = 0;  // indices into the scene
  PlaneFrame plane_frame;
  Placement T_table_object;
  double pose_s = 0.0;   // see PosedModel
  double reach = 0.0;    // contact_reach() [m]
  float opacity = 1.0F;  // minimum of the object's and the plane's
};

// A ShadowDraw as received by a phantom or by another virtual object above the plane. It is cast
// along the normal; a point of the receiver gets the shadow of a plane at its height
// (docs/rendering.md#shadows-on-receivers). Objects receive no shadow of themselves or their
// children, because their surface would be in contact with the caster everywhere.
struct ReceivedShadowDraw {
  int receiver = 0;   // index into Scene::objects, one of FramePlan::phantoms or objects
  ShadowDraw shadow;  // on the plane, with all layers; opacity at most that of the receiver
  // Radius around shadow.centre that contains every layer at every height [m]; infinity for kernels
  // from a file.
  double radius = 0.0;
  double top = 0.0;  // upper bound of the caster's height above the plane [m]
};

struct LitCaster {
  int object = 0, light = 0;  // indices into the scene
  Placement T_table_object;
  Eigen::Vector4d light_position;  // see PlacedLight::place
  bool proxy = true;               // the author's reduced model casts, if there is one
  float opacity = 1.0F;            // caster's opacity
  double pose_s = 0.0;             // see PosedModel
};

// One caster's projected shadow on one plane. opacity: minimum of the caster's and the plane's.
struct HardShadowDraw : LitCaster {
  int plane = 0;  // index into Scene::planes
  PlaneFrame plane_frame;
};

// One caster's shadow volume for one light. It darkens all surfaces in the depth buffer, or
// phantoms alone if the shadow on planes is a projected one. Each pair of caster and light occurs
// once. If any node uses volumes, the projected shadows of all nodes are drawn as volumes. The
// receiver's opacity multiplies the shadow's.
struct ShadowVolumeDraw : LitCaster {
  std::vector<PlaneFrame> floors;         // the unbounded receiving planes
  bool on_planes = true;                  // true: on all surfaces; false: on phantoms alone
  std::vector<BoundingSphere> receivers;  // phantoms that it may reach; empty: any surface
};

// Rays from a light through one caster's vertices onto planes.
struct LightRayDraw : LitCaster {
  struct Plane {
    int index = 0;  // into Scene::planes
    PlaneFrame frame;
  };
  std::vector<Plane> planes;
};

struct FramePlan {
  bool has_pose = false;
  CameraPose T_table_camera;
  Translucency translucency = Translucency::automatic;
  LayerDrawing layers = LayerDrawing::automatic;
  // False: reuses only kernels of earlier frames, and draws masks even where they have no effect.
  bool reuse = true;
  float overlay_opacity = 1.0F;      // 1 when tracked, lower when uncertain or coasting
  std::vector<PosedModel> posed;     // objects with an animation
  std::vector<ObjectDraw> phantoms;  // depth only
  std::vector<ObjectDraw> objects;
  std::vector<PlaneReceiver> receivers;  // each once, for all nodes and techniques; in view or not
  std::vector<ShadowDraw> shadows;
  // Skipped shadows. They count for masks, so that culling does not change how others are drawn.
  std::vector<ShadowDraw> skipped_shadows;
  std::vector<ContactDraw> contacts;  // each object and plane once
  std::vector<ReceivedShadowDraw> received_shadows;
  // Number of pairs of a caster and a receiver that its shadow may reach, in view or not. It limits
  // the resolution of their masks, which must not depend on the view.
  std::size_t caster_receiver_pairs = 0;
  std::vector<HardShadowDraw> hard_shadows;
  std::vector<ShadowVolumeDraw> volumes;
  int volume_lights = 0;  // number of lights with volumes, in view or not
  std::vector<LightRayDraw> rays;
  std::vector<PlacedLight> lights;  // one per Scene::lights
  Lighting lighting;
  double tone_exponent = kDefaultToneExponent;  // camera response: linear = encoded ^ exponent
  std::vector<SkippedPass> skipped;
};

// Returns the plan's draw of an object or phantom, or nullptr.
[[nodiscard]] const ObjectDraw* drawn_object(const FramePlan& plan, int object);

[[nodiscard]] FramePlan plan_frame(const Scene& scene, const SceneState& state,
                                   const PoseEstimate& pose, const CameraModel& camera,
                                   const PlanOptions& options = {});

}  // namespace penumbra
