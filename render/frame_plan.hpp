// What one frame needs drawn, decided before any GL call. Pure: the same scene, pose and options
// give the same plan.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "render/render_work.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/volumes/shadow_volume.hpp"
#include "render/translucency.hpp"

namespace penumbra {

// Gamma exponent of a camera whose response is not known: encoded = linear ^ (1 / exponent), close
// to sRGB (docs/rendering.md#tone).
inline constexpr double kUsualToneExponent = 2.2;

struct PlanOptions {
  Translucency translucency = Translucency::automatic;
  std::optional<ShadowTechnique> technique;  // overrides every shadow node's
  std::optional<KernelSource> kernels;       // overrides every shadow node's
  std::optional<LightMode> light_mode;       // overrides every shadow node's
  bool proxies = true;                       // false: every object casts with its own mesh
  LayerDrawing layers = LayerDrawing::automatic;
  bool light_rays = false;  // of every shadow node, whatever it says
  // Skip what can't be seen, and reuse what an earlier frame made; the image is the same either
  // way, bit for bit.
  bool skip = true;
};

struct ObjectDraw {
  int object = 0;  // index into Scene::objects
  Placement T_table_object;
  float opacity = 1.0F;  // no more than the overlay's
};

// A plane that shadows fall on, with the eye in front of it. It hides the planes behind it.
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
  // A disc on the plane that holds every layer [m], but for kernels from a file, which may lie
  // anywhere.
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0.0;
};

// Whether their layers have the same shapes; how dark they are and which of them show on the plane
// does not count.
[[nodiscard]] bool same_shapes(const ShadowDraw& a, const ShadowDraw& b);

// The part of such a shadow that falls on a phantom or on another virtual object before it reaches
// the plane: cast straight down onto every height of the receiver as on a plane there
// (docs/rendering.md#shadows-on-receivers). No object receives its own shadow, nor its children's:
// at every height its surface touches what of the object is above, and a penumbra begins there.
struct ReceivedShadowDraw {
  int receiver = 0;   // index into Scene::objects, one of FramePlan::phantoms or objects
  ShadowDraw shadow;  // on the plane, with all layers; its opacity includes the receiver's
  // A disc on the plane that holds every layer at every height [m]; infinite for kernels from a
  // file.
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
// on phantoms alone, where its shadow on planes is a projected one. Each caster and light occurs
// once. Where one node asks for volumes, the projected shadows of all nodes are drawn as volumes.
struct ShadowVolumeDraw {
  int node = 0, object = 0, light = 0;  // indices into the scene
  Placement T_table_object;
  Eigen::Vector4d light_place;     // as PlacedLight::place
  std::vector<PlaneFrame> floors;  // the unbounded planes that receive
  double reach = 0.0;              // of the volume, from the table's origin [m]
  bool on_planes = true;           // and on virtual objects
  std::vector<Ball> receivers;     // of phantoms alone: those that it may meet; empty: any
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

// The light on virtual objects beside the scene's lights. Linear, by channel.
struct Lighting {
  Eigen::Vector3d gain = Eigen::Vector3d::Ones();  // of the lights: those of the scene times this
  // From the upper half of the room and from below, on a surface that faces it.
  Eigen::Vector3d sky = Eigen::Vector3d::Zero();
  Eigen::Vector3d ground = Eigen::Vector3d::Zero();
};
// Where the light of the video is known, a white matt surface on the table is as bright as white
// paper there; darker where the scene's lights together give it less than 1, so that they can be
// dimmed. The light from below is that of the image around. Shadows on the table take the same
// share of the light either way.
[[nodiscard]] Lighting lighting_for(const Scene& scene, const SceneState& state);

// Returns the light that is left in the layers on a plane, `normal` up, through `place`, table
// frame. The scene's fractions hold up to the usual ambient light (Scene::kUsualAmbient). Casters
// block none of the ambient light beyond it, so the fractions rise (docs/rendering.md#tone).
[[nodiscard]] LightFractions lifted_by_ambient(const LightFractions& fractions, const Scene& scene,
                                               const std::vector<PlacedLight>& lights,
                                               const Eigen::Vector3d& normal,
                                               const Eigen::Vector3d& place);

struct FramePlan {
  bool has_pose = false;
  CameraPose T_table_camera;
  Translucency translucency = Translucency::automatic;  // of all that is drawn
  LayerDrawing layers = LayerDrawing::automatic;
  // For tests: casters' edges and masks are split for the nearest distance expected, not for the
  // present one; the image is the same to 0.15 px.
  bool finest_edges = false;
  bool whole_masks = false;          // draw masks of planes also where they darken nothing
  bool reuse = true;                 // false: of earlier frames, use only kernels
  float overlay_opacity = 1.0F;      // 1 when tracked, lower when uncertain or held
  std::vector<ObjectDraw> phantoms;  // depth only
  std::vector<ObjectDraw> objects;
  std::vector<PlaneReceiver> receivers;  // of all nodes' techniques, seen or not, each once
  std::vector<ShadowDraw> shadows;
  // Shadows skipped for being out of sight: culling one must not change how the rest is drawn.
  std::vector<ShadowDraw> unseen_shadows;
  std::vector<ReceivedShadowDraw> received_shadows;
  // Number of pairs of casters and receivers that may meet, in view or not. It limits the
  // resolution of their masks, which must not depend on the view.
  std::size_t meeting_pairs = 0;
  std::vector<HardShadowDraw> hard_shadows;
  std::vector<ShadowVolumeDraw> volumes;
  int volume_lights = 0;  // number of lights with volumes, in view or not
  std::vector<LightRayDraw> rays;
  std::vector<PlacedLight> lights;  // one per Scene::lights
  Lighting lighting;
  double tone_exponent = kUsualToneExponent;  // of the camera: linear light = encoded ^ exponent
  std::vector<SkippedPass> skipped;
};

// Returns what the plan draws of an object or phantom; null where that is nothing.
[[nodiscard]] const ObjectDraw* drawn_object(const FramePlan& plan, int object);

[[nodiscard]] FramePlan plan_frame(const Scene& scene, const SceneState& state,
                                   const PoseEstimate& pose, const CameraModel& camera,
                                   const PlanOptions& options = {});

}  // namespace penumbra
