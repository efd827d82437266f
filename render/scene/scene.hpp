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
#include "render/model/animated_model.hpp"
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

// Returns the placement to apply to a model's positions, which are relative to Model::origin.
[[nodiscard]] Placement placed_model(const Model& model, const Placement& T_world_object);

struct Keyframe {
  double time_s = 0.0;
  Placement placement;
};

// A path through keyframes, combined with a spin. Interpolation: positions linear or (smooth) by a
// non-uniform Catmull-Rom spline, rotations by slerp, scales linear.
struct Animation {
  enum class Interpolation { linear, smooth };
  std::vector<Keyframe> keyframes;  // ascending times; may be empty
  Interpolation interpolation = Interpolation::smooth;
  bool loop = true;  // repeats; the last keyframe should equal the first
  Eigen::Vector3d spin_axis = Eigen::Vector3d::UnitZ();  // object frame
  double spin_turns_per_s = 0.0;
};

// How an object plays an animation of its model.
struct Playback {
  std::shared_ptr<const AnimatedModel> model;  // null: the object is rigid
  double speed = 1.0;                          // seconds of the animation per second
  double start_s = 0.0;                        // time of the animation at the scene's time 0
  bool loop = true;                            // repeats from 0 to the time of the last key
  std::string animation{};                     // which one of the file: ModelPose::animation

  // Returns the time of the animation at a time of the scene.
  [[nodiscard]] double time_at(double scene_time_s) const;
};

struct SceneObject {
  std::string name;
  std::shared_ptr<const Model> model;  // with `playback`: its shape at the scene's time 0
  std::string model_file;              // resolved path, for messages and caches
  UpAxis up = UpAxis::by_format;       // of the model's file
  int parent = -1;                     // index of an earlier object, or -1: the table
  // Group of tags that an object without a parent moves with. `placement` applies when the group is
  // at its pose in the tag map.
  std::string tag_group = std::string(kTableGroup);
  Placement placement;  // relative to the parent; T_parent_object = placement * animation
  Animation animation;
  Playback playback;
  bool casts_shadow = true;
  // Parts that share one light: "all", or names of the model's nodes (part_groups.hpp).
  std::vector<std::string> groups;
  std::shared_ptr<const Model> proxy_model;  // the author's reduced model for casting; may be null
  bool phantom = false;                      // represents a real object: writes depth only
  bool cursor = false;   // the 3D cursor: at most one object, moves on the table
  bool added = false;    // by add_object(); not in the scene's file
  bool removed = false;  // an added object that is neither drawn nor casts
};

// Returns the model that casts an object's projected and volume shadows: its proxy if `proxies` and
// if it has one, else the model. Layered shadows compare the proxy first (shadow_proxy.hpp).
[[nodiscard]] const std::shared_ptr<const Model>& casting_model(const SceneObject& object,
                                                                bool proxies);

struct ScenePlane {
  std::string name;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // unit, towards the light
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector2d> outline;  // simple polygon in (u, v) [m]; empty: unbounded
  // Group of tags that the plane moves with. `normal` and `point` apply at its pose in the tag map.
  std::string tag_group = std::string(kTableGroup);
};

// The sun at a geographic position; gives no light while below the horizon.
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
  // Keyframe positions are added to the position; rotations and spin rotate the direction (table
  // frame).
  Animation animation;
  std::optional<Sun> sun;  // determines the direction of a directional light
};

// Fraction of linear light left in each layer, 0 (black) to 1.
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
  bool light_rays = false;  // hard and volume: also draws rays from the lights
  friend bool operator==(const ShadowStyle&, const ShadowStyle&) = default;
};

// Casters x planes x lights with one technique.
struct ShadowNode : ShadowStyle {
  std::string name;
  std::vector<int> casters;    // indices into Scene::objects
  std::vector<int> planes;     // indices into Scene::planes
  std::vector<int> walls;      // additional planes for the technique `walls`
  bool default_walls = false;  // `walls` are left to add_default_walls()
  std::vector<int> lights;     // indices into Scene::lights; empty: the first light
  LightMode light_mode = LightMode::proportional;  // layered shadows; cocl: never `fixed`
  bool contact = false;  // draws contact shades (contact_shade.hpp), with every technique but none
};

// Advice about the limits of a node's layered shadows; irrelevant to other techniques.
struct LayeredAdvice {
  int node = 0;  // index into Scene::shadows
  std::string text;
};

struct Scene {
  std::string name;
  std::string file;
  std::shared_ptr<const std::string> json;  // content of the file; null if there is none
  std::vector<SceneObject> objects;         // parents precede their children
  std::vector<ScenePlane> planes;
  std::vector<SceneLight> lights;
  std::vector<ShadowNode> shadows;
  // Ambient luminance (a bright room) up to which lifted_by_ambient() changes no fractions.
  static constexpr double kBrightRoomAmbient = 0.36;
  Eigen::Vector3d ambient = Eigen::Vector3d::Constant(0.35);  // linear
  std::vector<std::string> warnings;                          // about valid but inadvisable content
  std::vector<LayeredAdvice> layered_advice;
};

// A light in the table frame. position: a point (w = 1), or the unit direction to the light (w =
// 0).
struct PlacedLight {
  Eigen::Vector4d position = Eigen::Vector4d::UnitW();
  Eigen::Vector3d color = Eigen::Vector3d::Ones();  // linear, times the intensity
};

// Returns the light of scenes without lights: a lamp above the user's left shoulder.
[[nodiscard]] PlacedLight default_light();

// A plane in the table frame; its axes rotate with its group.
struct PlacedPlane {
  PlaneFrame frame;
  double opacity = 1.0;  // opacity_for() of its group; 0: the plane is absent
};

// Placements of objects, planes and lights at a time after the start, table frame.
struct SceneState {
  double time_s = 0.0;
  std::vector<Placement> objects;   // one per Scene::objects
  std::vector<double> opacities;    // one per object, see PlacedPlane::opacity; empty: all 1
  std::vector<double> poses;        // one per object: Playback::time_at(); empty: all are rigid
  std::vector<PlacedPlane> planes;  // one per Scene::planes; empty: as in the scene
  std::vector<PlacedLight> lights;  // one per Scene::lights
  // The light that the scene's lights are scaled to; nullopt: not scaled.
  std::optional<VideoLight> video_light;
};
// `groups`: poses of the tag groups other than the table. Objects and planes of groups without a
// pose get opacity 0.
[[nodiscard]] SceneState evaluate_scene(const Scene& scene, double time_s,
                                        std::span<const GroupEstimate> groups = {});

[[nodiscard]] PlacedPlane placed_plane(const Scene& scene, const SceneState& state, int plane);
[[nodiscard]] double opacity_of(const SceneState& state, int object);
// Returns the time of an object's animation; 0 if it is rigid.
[[nodiscard]] double pose_of(const SceneState& state, int object);
// Returns the shape of an object at this time; null for an object without a model. If the animation
// has no shape at this time (AnimatedModel::at() fails), returns SceneObject::model and sets
// `is_missing`, unless it is null.
[[nodiscard]] std::shared_ptr<const Model> shape_of(const Scene& scene, const SceneState& state,
                                                    int object, bool* is_missing = nullptr);

// Returns the tag groups, except the table, of objects and of planes of shadow nodes; sorted.
[[nodiscard]] std::vector<std::string> tag_groups_of(const Scene& scene);

// Returns the opacity of content at a pose of this status: 1 tracked, 0.5 uncertain, 0 lost. Held
// (extrapolated) poses fade out, starting at the opacity of `held_from`.
[[nodiscard]] double opacity_for(TrackStatus status, TrackStatus held_from, double age_s);

// Returns an upper bound of each object's scale in the table frame over all times.
[[nodiscard]] std::vector<double> largest_scales(const Scene& scene);
// Returns the maximum height of each object's bounding sphere above the plane over all times [m],
// sampled at keyframes and between them.
[[nodiscard]] std::vector<double> sphere_heights(const Scene& scene,
                                                 const Eigen::Vector3d& plane_normal,
                                                 const Eigen::Vector3d& plane_point);
// Returns the maximum height of each object's vertices above the plane at the same times [m].
[[nodiscard]] std::vector<double> vertex_heights(const Scene& scene,
                                                 const Eigen::Vector3d& plane_normal,
                                                 const Eigen::Vector3d& plane_point);

// Adds virtual walls for the technique `walls` (multiple orthographic shadows): two vertical planes
// on the node's first plane, at the far sides of the box that its casters occupy over all times.
// They face a viewer at the front right (x > 0, y < 0). Adds none if there are no casters or a
// plane of the node is not horizontal. A second call moves the walls to the present casters.
void add_default_walls(Scene& scene, ShadowNode& node);

// Adds an object, which becomes a caster: on each plane of one shadow node, preferably a layered
// one, so that it casts one shadow. Moves default walls.
void add_object(Scene& scene, SceneObject object);
// Returns `wanted`, or "wanted 2", "wanted 3", ... if an object has that name.
[[nodiscard]] std::string free_object_name(const Scene& scene, const std::string& wanted);

// Reads a scene, checks it against the published schema (scenes/scene.schema.json) and loads its
// models, whose paths are relative to the scene's file. Errors contain the file and the JSON
// pointer ("scene.json: /objects/2/scale: ..."), and the model's file if a model fails.
[[nodiscard]] Result<Scene> load_scene(const std::filesystem::path& file);

}  // namespace penumbra
