// What is drawn into the video: objects, phantoms, planes, lights and shadow nodes. Table frame,
// metres; read from JSON by scene_file.
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

// Placement of a model's positions, which are relative to Model::origin, where the object that has
// it stands at `T_world_object`.
[[nodiscard]] Placement placed_model(const Model& model, const Placement& T_world_object);

struct Keyframe {
  double time_s = 0.0;
  Placement placement;
};

// A path through keyframes, and a spin on top of it. Smooth: positions along a cubic whose velocity
// at a key is that between its two neighbours (Catmull-Rom for keys at uneven times; no kink).
// Linear: positions along straight lines. Both turn by slerp and scale linearly from key to key.
struct Animation {
  enum class Interpolation { linear, smooth };
  std::vector<Keyframe> keyframes;  // in order of time; may be empty
  Interpolation interpolation = Interpolation::smooth;
  bool loop = true;  // the last keyframe leads back to the first; both should agree
  Eigen::Vector3d spin_axis = Eigen::Vector3d::UnitZ();  // object frame
  double spin_turns_per_s = 0.0;
};

struct SceneObject {
  std::string name;
  std::shared_ptr<const Model> model;
  std::string model_file;  // as resolved, for messages and caches
  int parent = -1;         // index of an earlier object, or -1: the table
  // What an object without a parent moves with: a group of tags. Its placement is where it is on
  // the table while the group stands where the tag map has it.
  std::string tag_group = std::string(kTableGroup);
  Placement placement;  // relative to the parent; the animation's keyframes come on top of it
  Animation animation;
  bool casts_shadow = true;
  // Parts that share one light: "all", or names of the model's nodes (part_groups.hpp).
  std::vector<std::string> groups;
  std::shared_ptr<const Model> proxy_model;  // reduced by the author, for casting; may be null
  bool phantom = false;                      // stands for a real thing: writes depth only
  bool cursor = false;                       // a person's 3D cursor; at most one, on the table
};

// Returns the model that casts an object's projected and volume shadows: the author's reduced one
// where `proxies` is set, else its own. Layered shadows use the reduced one only where its layers
// agree with the model's (shadow_proxy.hpp). The object must have a model.
[[nodiscard]] const std::shared_ptr<const Model>& casting_model(const SceneObject& object,
                                                                bool proxies);

struct ScenePlane {
  std::string name;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // unit, towards the light side
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector2d>
      outline;  // simple polygon in the plane's (u, v) [m]; empty: unbounded
  // The group of tags that the plane moves with. Normal and point are where it is on the table
  // while the group stands where the tag map has it.
  std::string tag_group = std::string(kTableGroup);
};

// The sun over a place on the earth: what it gives is white and as the light says, and nothing
// while it is under the horizon.
struct Sun {
  double latitude_deg = 0.0;   // north > 0
  double longitude_deg = 0.0;  // east > 0
  double start_utc_s = 0.0;    // seconds since 1970-01-01 00:00 UTC, at the scene's time 0
  double hours_per_s = 0.0;    // how much of the day passes in a second of the scene
  double north_deg = 0.0;      // where north is on the table: turned left (towards -x) from +y
};

struct SceneLight {
  enum class Kind { point, directional };
  std::string name;
  Kind kind = Kind::point;
  Eigen::Vector3d position = Eigen::Vector3d(0.0, 0.0, 1.0);  // point: [m]
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // directional: unit, TOWARDS the light
  Eigen::Vector3d color = Eigen::Vector3d::Ones();       // linear
  double intensity = 1.0;
  // A point moves along the keyframes' positions, on top of its own; a direction turns by their
  // rotations and the spin (table frame).
  Animation animation;
  std::optional<Sun> sun;  // of a directional light: where its direction comes from
};

// Share of the light that is left in each layer, in linear light, 0 (black) to 1.
struct LightFractions {
  double umbra = 0.15;
  double middle = 0.4;
  double penumbra = 0.83;
};

// Casters x planes x lights with one technique.
struct ShadowNode {
  std::string name;
  std::vector<int> casters;  // indices into Scene::objects
  std::vector<int> planes;   // indices into Scene::planes
  std::vector<int> walls;    // further planes, that `walls` falls on
  std::vector<int> lights;   // indices into Scene::lights; layered and simple shadows need none;
                             // empty: the scene's first
  ShadowTechnique technique = ShadowTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
  LightMode light_mode = LightMode::proportional;  // of layered shadows; cocl has no other
  LayeredConstants layered;
  LightFractions fractions;
  bool light_rays = false;  // hard and volume: rays from the lights are drawn too
};

// What a node's layered shadows can't show well: of no use where another technique is drawn.
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
  // Luminance, up to which shadows' light fractions are as they are given (lifted_by_ambient()): a
  // bright room's, which most bundled scenes have.
  static constexpr double kUsualAmbient = 0.36;
  Eigen::Vector3d ambient = Eigen::Vector3d::Constant(0.35);  // linear
  std::vector<std::string> warnings;  // what is legal but against the sources' advice
  std::vector<LayeredAdvice> layered_advice;
};

// Where a light is (w = 1), or the unit direction towards it (w = 0), in the table frame; and what
// it gives.
struct PlacedLight {
  Eigen::Vector4d place = Eigen::Vector4d::UnitW();
  Eigen::Vector3d color = Eigen::Vector3d::Ones();  // linear, times the intensity
};

// What shows the objects of a scene without lights: a lamp over the left shoulder.
[[nodiscard]] PlacedLight lamp_of_no_scene();

// A plane in the table frame, its axes carried along by its group.
struct PlacedPlane {
  PlaneFrame frame;
  // 1; of a plane tied to a group lower where the group's place is uncertain or held, 0 where it is
  // not known: then there is no plane.
  double opacity = 1.0;
};

// Every object's placement, every plane's and every light's, in the table frame at a time after the
// start.
struct SceneState {
  double time_s = 0.0;
  std::vector<Placement> objects;   // one per Scene::objects
  std::vector<double> opacities;    // of the objects, as PlacedPlane::opacity; none: all 1
  std::vector<PlacedPlane> planes;  // one per Scene::planes; none: as the scene has them
  std::vector<PlacedLight> lights;  // one per Scene::lights
  // That of the video, which the scene's lights are brought to; none: they are as the scene says.
  std::optional<VideoLight> video_light;
};
// `groups`: where those beside the table are. What is tied to another one has opacity 0.
[[nodiscard]] SceneState evaluate_scene(const Scene& scene, double time_s,
                                        std::span<const GroupEstimate> groups = {});

[[nodiscard]] PlacedPlane placed_plane(const Scene& scene, const SceneState& state, int plane);
[[nodiscard]] double opacity_of(const SceneState& state, int object);

// The groups beside the table that something in the scene is tied to, each once and in order of
// their names: its objects, and planes that a shadow node names.
[[nodiscard]] std::vector<std::string> tag_groups_of(const Scene& scene);

// How strongly something is drawn whose place has this status: 1 tracked, half of it uncertain; a
// held place is continued motion, trusted less with every moment, and fades out from how the place
// before it was drawn; 0 lost.
[[nodiscard]] double opacity_for(TrackStatus status, TrackStatus held_from, double age_s);

// Over all times, one per Scene::objects: the largest scale in the table frame (or a little more,
// where the largest of an object and of its parent come at different times).
[[nodiscard]] std::vector<double> largest_scales(const Scene& scene);
// The farthest that any point of the object's model comes above the plane [m], for each object,
// over all times: at its keys and at steps between them, a sphere about its origin taken for its
// shape.
[[nodiscard]] std::vector<double> greatest_heights(const Scene& scene,
                                                   const Eigen::Vector3d& plane_normal,
                                                   const Eigen::Vector3d& plane_point);
// As the scene has them, nothing turned by hand: each object's highest point above the plane [m],
// at the same times.
[[nodiscard]] std::vector<double> highest_points(const Scene& scene,
                                                 const Eigen::Vector3d& plane_normal,
                                                 const Eigen::Vector3d& plane_point);

// Virtual walls for `walls` (multiple orthographic shadows): two vertical planes through the far
// edges of the working volume, which is what the node's casters come to over all times. They stand
// on the node's first plane and face a viewer at its right and front (x > 0, y < 0). New planes of
// the scene, named after the node; none where nothing casts, the first plane is not level, or the
// node has planes that stand up already.
void add_default_walls(Scene& scene, ShadowNode& node);

// Reads a scene, checks it against the published schema (scenes/scene.schema.json) and loads its
// models, paths relative to the scene's file. Errors name the file and the place in it
// ("scene.json: /objects/2/scale: ..."), and for a model its file as well.
[[nodiscard]] Result<Scene> load_scene(const std::filesystem::path& file);

}  // namespace penumbra
