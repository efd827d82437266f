// A scene that is drawn into the video: objects, phantoms, planes, lights and shadow nodes. Table
// frame, metres.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/transform.hpp"
#include "render/model/model.hpp"
#include "render/scene/layered_constants.hpp"
#include "render/scene/light_meter.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/technique.hpp"

namespace penumbra {

// Position, rotation and uniform scale: p_parent = position + rotation * (scale * p_object).
struct Placement {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // [m]
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  double scale = 1.0;  // > 0

  [[nodiscard]] Eigen::Vector3d operator*(const Eigen::Vector3d& p) const {
    return position + rotation * (scale * p);
  }
  [[nodiscard]] Placement operator*(const Placement& child) const {
    return {*this * child.position, (rotation * child.rotation).normalized(), scale * child.scale};
  }
  friend bool operator==(const Placement& a, const Placement& b) {
    return a.position == b.position && a.rotation.coeffs() == b.rotation.coeffs() &&
           a.scale == b.scale;
  }
};

// Returns the placement of a model's positions, which are relative to Model::origin.
[[nodiscard]] Placement placed_model(const Model& model, const Placement& T_world_object);

struct Keyframe {
  double time_s = 0.0;
  Placement placement;
};

// A path through keyframes, and a spin on top of it. Smooth positions follow Catmull-Rom splines
// for keys at uneven times. Rotations follow slerp, scales are linear.
struct Animation {
  enum class Interpolation { linear, smooth };
  std::vector<Keyframe> keyframes;  // in order of time; may be empty
  Interpolation interpolation = Interpolation::smooth;
  bool loop = true;  // the last keyframe, which should equal the first, leads back to it
  Eigen::Vector3d spin_axis = Eigen::Vector3d::UnitZ();  // object frame
  double spin_turns_per_s = 0.0;
};

struct SceneObject {
  std::string name;
  std::shared_ptr<const Model> model;
  std::string model_file;  // as resolved, for messages and caches
  int parent = -1;         // index of an earlier object, or -1: the table
  // Group of tags that an object without a parent moves with. The placement holds while the group
  // stands at its place in the tag map.
  std::string tag_group = std::string(kTableGroup);
  Placement placement;  // relative to the parent; T_parent_object = placement * animation
  Animation animation;
  bool casts_shadow = true;
  // Parts that share one light: "all", or names of the model's nodes (part_groups.hpp).
  std::vector<std::string> groups;
  std::shared_ptr<const Model> proxy_model;  // reduced by the author, for casting; may be null
  bool phantom = false;                      // stands for a real thing: writes depth only
  bool cursor = false;                       // the user's 3D cursor; at most one, on the table
};

// Returns the model that casts an object's projected and volume shadows: the proxy if `proxies` is
// set, else its own. Layered shadows check the proxy first (shadow_proxy.hpp).
[[nodiscard]] const std::shared_ptr<const Model>& casting_model(const SceneObject& object,
                                                                bool proxies);

struct ScenePlane {
  std::string name;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // unit, towards the light side
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector2d> outline;  // simple polygon in (u, v) [m]; empty: unbounded
  // Group of tags that the plane moves with. Normal and point hold while the group stands at its
  // place in the tag map.
  std::string tag_group = std::string(kTableGroup);
};

// The sun over a place on the earth; dark while it is under the horizon.
struct Sun {
  double latitude_deg = 0.0;   // north > 0
  double longitude_deg = 0.0;  // east > 0
  double start_utc_s = 0.0;    // seconds since 1970-01-01 00:00 UTC, at the scene's time 0
  double hours_per_s = 0.0;    // hours of the day per second of the scene
  double north_deg = 0.0;      // direction of north on the table, from +y towards -x
};

struct SceneLight {
  enum class Kind { point, directional };
  std::string name;
  Kind kind = Kind::point;
  Eigen::Vector3d position = Eigen::Vector3d(0.0, 0.0, 1.0);  // point: [m]
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // directional: unit, TOWARDS the light
  Eigen::Vector3d color = Eigen::Vector3d::Ones();       // linear
  double intensity = 1.0;
  // The keyframes' positions are added to a point's; rotations and spin turn a direction (table
  // frame).
  Animation animation;
  std::optional<Sun> sun;  // source of a directional light's direction
};

// Share of linear light left in each layer, 0 (black) to 1.
struct LightFractions {
  double umbra = 0.15;
  double middle = 0.4;
  double penumbra = 0.83;
  friend bool operator==(const LightFractions&, const LightFractions&) = default;
};

// The part of a shadow node that a session may change.
struct ShadowStyle {
  ShadowTechnique technique = ShadowTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
  LayeredConstants layered;
  LightFractions fractions;
  bool light_rays = false;  // hard and volume: rays from the lights are drawn too
};

// Casters x planes x lights with one technique.
struct ShadowNode : ShadowStyle {
  std::string name;
  std::vector<int> casters;  // indices into Scene::objects
  std::vector<int> planes;   // indices into Scene::planes
  std::vector<int> walls;    // further planes for the technique `walls`
  std::vector<int> lights;   // indices into Scene::lights; empty: the first, if one is needed
  LightMode light_mode = LightMode::proportional;  // of layered shadows; cocl has no other
};

// Limits of a node's layered shadows; irrelevant to other techniques.
struct LayeredAdvice {
  int node = 0;  // index into Scene::shadows
  std::string text;
};

struct Scene {
  std::string name;
  std::string file;
  std::vector<SceneObject> objects;  // parents come before their children
  std::vector<ScenePlane> planes;
  std::vector<SceneLight> lights;
  std::vector<ShadowNode> shadows;
  // Luminance up to which shadows keep their light fractions (lifted_by_ambient()): a bright room.
  static constexpr double kUsualAmbient = 0.36;
  Eigen::Vector3d ambient = Eigen::Vector3d::Constant(0.35);  // linear
  std::vector<std::string> warnings;                          // about legal but inadvisable content
  std::vector<LayeredAdvice> layered_advice;
};

// Position of a light (w = 1) or unit direction towards it (w = 0), table frame, and its colour.
struct PlacedLight {
  Eigen::Vector4d place = Eigen::Vector4d::UnitW();
  Eigen::Vector3d color = Eigen::Vector3d::Ones();  // linear, times the intensity
};

// Returns the light of scenes without lights: a lamp over the left shoulder.
[[nodiscard]] PlacedLight default_light();

// A plane in the table frame; its axes turn with its group.
struct PlacedPlane {
  PlaneFrame frame;
  double opacity = 1.0;  // opacity_for() its group; 0: there is no plane
};

// Placements of objects, planes and lights at a time after the start, table frame.
struct SceneState {
  double time_s = 0.0;
  std::vector<Placement> objects;   // one per Scene::objects
  std::vector<double> opacities;    // of the objects, as PlacedPlane::opacity; empty: all 1
  std::vector<PlacedPlane> planes;  // one per Scene::planes; empty: as in the scene
  std::vector<PlacedLight> lights;  // one per Scene::lights
  // The light that the scene's lights are scaled to; without it they keep the scene's values.
  std::optional<VideoLight> video_light;
};
// `groups`: the poses of groups beside the table. Objects and planes of other groups get opacity 0.
[[nodiscard]] SceneState evaluate_scene(const Scene& scene, double time_s,
                                        std::span<const GroupEstimate> groups = {});

[[nodiscard]] PlacedPlane placed_plane(const Scene& scene, const SceneState& state, int plane);
[[nodiscard]] double opacity_of(const SceneState& state, int object);

// Returns the groups beside the table that objects, and planes of shadow nodes, move with; sorted.
[[nodiscard]] std::vector<std::string> tag_groups_of(const Scene& scene);

// Returns the opacity of things at a pose of this status: 1 tracked, 0.5 uncertain, 0 lost. Held
// (extrapolated) poses fade out from the opacity of `held_from`.
[[nodiscard]] double opacity_for(TrackStatus status, TrackStatus held_from, double age_s);

// Returns an upper bound of each object's scale in the table frame over all times.
[[nodiscard]] std::vector<double> largest_scales(const Scene& scene);
// Returns the greatest height of each object above the plane over all times [m]: of a sphere around
// it, at its keys and at steps between them.
[[nodiscard]] std::vector<double> greatest_heights(const Scene& scene,
                                                   const Eigen::Vector3d& plane_normal,
                                                   const Eigen::Vector3d& plane_point);
// Returns the height of each object's highest point above the plane at the same times [m].
[[nodiscard]] std::vector<double> highest_points(const Scene& scene,
                                                 const Eigen::Vector3d& plane_normal,
                                                 const Eigen::Vector3d& plane_point);

// Adds virtual walls for the technique `walls` (multiple orthographic shadows): two vertical planes
// on the node's first plane, through the far edges of the volume that its casters reach over all
// times. They face a viewer at the right and front (x > 0, y < 0). Adds none without casters or if
// a plane of the node is not level.
void add_default_walls(Scene& scene, ShadowNode& node);

// Reads a scene, checks it against the published schema (scenes/scene.schema.json) and loads its
// models, paths relative to the scene's file. Errors name the file and the place in it
// ("scene.json: /objects/2/scale: ..."), and for a model its file as well.
[[nodiscard]] Result<Scene> load_scene(const std::filesystem::path& file);

}  // namespace penumbra
