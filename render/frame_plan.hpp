// What one frame needs drawn, decided before any GL call. Pure: the same scene, pose and options
// give the same plan.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/volumes/shadow_volume.hpp"
#include "render/translucency.hpp"

namespace penumbra {

// Of a camera whose tone curve is not known: encoded = linear ^ (1 / exponent), near enough to sRGB
// (rendering.md 3).
inline constexpr double kUsualToneExponent = 2.2;

struct PlanOptions {
  Translucency translucency = Translucency::automatic;
  std::optional<ShadowTechnique> technique;  // overrides every shadow node's
  std::optional<KernelSource> kernels;       // overrides every shadow node's
  std::optional<LightMode> light_mode;       // overrides every shadow node's
  bool proxies = true;                       // false: every object casts with its own mesh
  LayerDrawing layers = LayerDrawing::automatic;
  bool light_rays = false;  // of every shadow node, whatever it says
  // Leave out what can't be seen, and make nothing again that an earlier frame made; the picture is
  // the same either way, bit for bit.
  bool skip = true;
  // Split casters' edges and masks as the nearest distance expected asks for, not as the present
  // one does;
  // the picture is the same to 0.15 px.
  bool finest_edges = false;
};

struct ObjectDraw {
  int object = 0;  // index into Scene::objects
  Placement T_table_object;
  float opacity = 1.0F;  // no more than the overlay's
};

// A plane that shadows fall on. In front of each of them the eye sees it, and it hides those
// behind.
struct PlaneReceiver {
  int plane = 0;  // index into Scene::planes
  PlaneFrame frame;
  float opacity = 1.0F;  // of what falls on it; no more than the overlay's
};

// One caster's layered, field or simple shadow on one plane. `walls` are simple ones.
struct ShadowDraw {
  int node = 0, object = 0, plane = 0;  // indices into the scene
  ShadowTechnique technique = ShadowTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
  LightMode light_mode = LightMode::proportional;
  bool proxy = true;  // a reduced mesh may cast, where the object allows it
  PlaneFrame plane_frame;
  Placement T_table_object;
  LayeredConstants constants;
  LightFractions fractions;                           // the scene's, lifted by its ambient light
  double tone_exponent = kUsualToneExponent;          // FramePlan::tone_exponent
  bool umbra = true, middle = true, penumbra = true;  // which layers have anything to draw
  bool off_outline = false;                           // its bounds do not meet the plane's outline
  float opacity = 1.0F;                               // of caster and plane together
  // On the plane, what holds every layer [m]; kernels that are given may lie anywhere, and what
  // they make is not held.
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0.0;
};

// Whether their layers have the same shapes. How dark they are, and which are seen on the plane,
// does not count.
[[nodiscard]] bool same_shapes(const ShadowDraw& a, const ShadowDraw& b);

// The part of such a shadow that falls on a phantom or on another virtual object before it reaches
// the plane. Cast straight down on every height of it as on a plane there, so that layers tell the
// height above what they fall on. No object receives its own, nor that of what hangs on it: every
// height of a surface is in contact with what of the object lies above it, and a penumbra begins
// there.
struct ReceivedShadowDraw {
  int receiver = 0;   // index into Scene::objects, one of FramePlan::phantoms or objects
  ShadowDraw shadow;  // on the plane; its opacity is the receiver's as well, its layers are all
  // On the plane, what holds every layer at every height [m]; without end where kernels are given.
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0.0;
  double top = 0.0;  // of the caster above the plane, no less than its own [m]
};

// One caster's projected shadow on one plane from one light.
struct HardShadowDraw {
  int node = 0, object = 0, plane = 0, light = 0;  // indices into the scene
  PlaneFrame plane_frame;
  Placement T_table_object;
  Eigen::Vector4d light_place;  // as PlacedLight::place
  bool proxy = true;            // the author's reduced model casts, where there is one
  float opacity = 1.0F;         // of caster and plane together
};

// One caster's shadow volume from one light, on everything that is drawn into the depth buffer; or
// on phantoms alone, where its shadow on planes is a projected one. Each caster and light once,
// whatever nodes ask for it, and all of a frame alike: where one node asks for volumes, the
// projected shadows of all are drawn as volumes.
struct ShadowVolumeDraw {
  int node = 0, object = 0, light = 0;  // indices into the scene
  Placement T_table_object;
  Eigen::Vector4d light_place;     // as PlacedLight::place
  std::vector<PlaneFrame> floors;  // the unbounded planes that receive
  double reach = 0.0;              // of the volume, from the table's origin [m]
  bool on_planes = true;           // and on virtual objects
  std::vector<Ball> receivers;     // what it may fall on where not; none: anything
  bool proxy = true;               // the author's reduced model casts, where there is one
  float opacity = 1.0F;            // of the caster; where it falls, the receiver's counts as well
};

// Rays from a light through one caster's vertices onto planes.
struct LightRayDraw {
  struct Plane {
    int index = 0;  // into Scene::planes
    PlaneFrame frame;
  };
  int object = 0, light = 0;  // indices into the scene
  Placement T_table_object;
  Eigen::Vector4d light_place;  // as PlacedLight::place
  std::vector<Plane> planes;
  bool proxy = true;  // they go through what casts: the author's reduced model, where there is one
  float opacity = 1.0F;  // of the caster
};

struct SkippedPass {
  std::string what;    // counter in the report: "object_out_of_view", "shadow_out_of_view",
                       // "umbra_vanished", ...
  std::string reason;  // for the HUD: "rotor: outside the view"
};

// What was not done anew, for what is there from an earlier picture does.
struct KeptPart {
  std::string what;    // counter in the report: "video", ...
  std::string reason;  // for the HUD: "video: the frame is on the GPU already"
};

// What virtual things are lit with beside the scene's lights. Linear, by channel.
struct Lighting {
  Eigen::Vector3d gain = Eigen::Vector3d::Ones();  // of the lights: those of the scene times this
  // From the upper half of the room and from below, on a surface that faces it.
  Eigen::Vector3d sky = Eigen::Vector3d::Zero();
  Eigen::Vector3d ground = Eigen::Vector3d::Zero();
};
// Where the light of the video is known, a white matt surface that lies on the table shows as much
// of it as white paper there would; less where all lights of the scene together give it less than
// 1, so that they can be dimmed, and never more. What comes from below is what the picture shows.
// Shadows on the table take the same share of its light either way.
[[nodiscard]] Lighting lighting_for(const Scene& scene, const SceneState& state);

// What is left of the light in the layers on a plane, `normal` up, through `place`, table frame.
// The scene's fractions are those under the usual ambient light (Scene::kUsualAmbient) or less; of
// more of it no caster takes anything away, and what the layers take away of all the light falls as
// the lights' share in it does (rendering.md 3: lifted by ambient).
[[nodiscard]] LightFractions lifted_by_ambient(const LightFractions& fractions, const Scene& scene,
                                               const std::vector<PlacedLight>& lights,
                                               const Eigen::Vector3d& normal,
                                               const Eigen::Vector3d& place);

struct FramePlan {
  bool has_pose = false;
  CameraPose T_table_camera;
  Translucency translucency = Translucency::automatic;  // of all that is drawn
  LayerDrawing layers = LayerDrawing::automatic;
  bool finest_edges = false;         // of casters and masks, whatever the distance
  bool whole_masks = false;          // of planes: also where they darken nothing
  bool reuse = true;                 // false: nothing that an earlier frame made, but kernels
  float overlay_opacity = 1.0F;      // 1 when tracked, lower when uncertain or held
  std::vector<ObjectDraw> phantoms;  // depth only
  std::vector<ObjectDraw> objects;
  std::vector<PlaneReceiver> receivers;  // of all nodes' techniques, seen or not, each once
  std::vector<ShadowDraw> shadows;
  // What is left out of them for being out of sight. How the others are drawn must not hang on
  // that.
  std::vector<ShadowDraw> unseen_shadows;
  std::vector<ReceivedShadowDraw> received_shadows;
  // How many casters and receivers of all planes may meet, in view or not: what they share must not
  // hang on what is seen.
  std::size_t meeting_pairs = 0;
  std::vector<HardShadowDraw> hard_shadows;
  std::vector<ShadowVolumeDraw> volumes;
  int volume_lights = 0;  // that have volumes, seen or not: how they are drawn hangs on it
  std::vector<LightRayDraw> rays;
  std::vector<PlacedLight> lights;  // one per Scene::lights
  Lighting lighting;
  double tone_exponent = kUsualToneExponent;  // of the camera: linear light = encoded ^ exponent
  std::vector<SkippedPass> skipped;
};

// What the plan draws of an object, a phantom or not; null where it draws nothing of it.
[[nodiscard]] const ObjectDraw* drawn_object(const FramePlan& plan, int object);

[[nodiscard]] FramePlan plan_frame(const Scene& scene, const SceneState& state,
                                   const PoseEstimate& pose, const CameraModel& camera,
                                   const PlanOptions& options = {});

}  // namespace penumbra
