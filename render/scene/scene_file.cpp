// Reads a scene from JSON validated against the schema (scene_json.hpp). Checks what a schema can't
// express: names that must exist, and mutually exclusive keys.
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>
#include <set>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "render/model/model_size.hpp"
#include "render/model/part_groups.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/model/to_eigen.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/scene/scene_json.hpp"
#include "render/scene/shapes.hpp"

namespace penumbra {
namespace {

using nlohmann::json;

constexpr double kMinKeySpacing_s = 1e-6;

// A value of the file and its JSON pointer.
struct Entry {
  const json& value;
  std::string place;

  [[nodiscard]] Entry operator[](const std::string& key) const {
    return {value.at(key), place + "/" + key};
  }
  [[nodiscard]] std::optional<Entry> find(const char* key) const {
    if (!value.contains(key)) return std::nullopt;
    return (*this)[key];
  }
  [[nodiscard]] std::string text() const { return value.get<std::string>(); }
  // Returns an error with the JSON pointer. load_scene() adds the file's name.
  template <class... Args>
  [[nodiscard]] tl::unexpected<Error> fault(fmt::format_string<Args...> text,
                                            Args&&... args) const {
    return fail("{}: {}", place, fmt::format(text, std::forward<Args>(args)...));
  }
};

Eigen::Vector3d vector_of(const json& from) {
  return {from[0].get<double>(), from[1].get<double>(), from[2].get<double>()};
}

Eigen::Vector3d vector_or(const json& from, const char* key, const Eigen::Vector3d& fallback) {
  const auto entry = from.find(key);
  return entry == from.end() ? fallback : vector_of(*entry);
}

Result<Eigen::Vector3d> direction_of(const Entry& from, std::string_view wanted = "a direction") {
  Eigen::Vector3d direction = vector_of(from.value);
  if (direction.norm() < 1e-9) return from.fault("has no length; give {}", wanted);
  direction.normalize();
  return direction;
}

template <class List>
int index_of(const List& list, const std::string& name) {
  const auto found = std::ranges::find(list, name, &List::value_type::name);
  return found == list.end() ? -1 : static_cast<int>(found - list.begin());
}

template <class List>
std::string suggestion_from(const List& list, const std::string& name) {
  std::vector<std::string> names;
  for (const auto& entry : list) names.push_back(entry.name);
  return suggestion(name, names);
}

// Returns an entry's name; fails if an element of the list already has it.
template <class List>
Result<std::string> new_name(const Entry& from, const List& list) {
  const Entry name = from["name"];
  if (index_of(list, name.text()) < 0) return name.text();
  return name.fault("\"{}\" is taken; give each its own name", shortened(name.text()));
}

// Returns the list indices of the named elements; fails for unknown or repeated names. `kind`: what
// the elements are, for messages.
template <class List>
Result<std::vector<int>> indices_of(const Entry& names, const List& list, std::string_view kind) {
  std::vector<int> indices;
  for (std::size_t i = 0; i < names.value.size(); ++i) {
    const Entry entry{names.value[i], fmt::format("{}/{}", names.place, i)};
    const std::string name = entry.text();
    const int index = index_of(list, name);
    if (index < 0) {
      return entry.fault("there is no {} \"{}\"; {}", kind, shortened(name),
                         suggestion_from(list, name));
    }
    if (std::ranges::find(indices, index) != indices.end()) {
      return entry.fault("\"{}\" is named twice; name it once", shortened(name));
    }
    indices.push_back(index);
  }
  return indices;
}

// Rotations in the file are applied about the parent's x, then y, then z axis.
Placement placement_of(const json& from) {
  Placement placement;
  placement.position = vector_or(from, "position", placement.position);
  if (const auto at = from.find("rotation_deg"); at != from.end()) {
    const Eigen::Vector3d angles = vector_of(*at);
    placement.rotation = Eigen::AngleAxisd(radians(angles.z()), Eigen::Vector3d::UnitZ()) *
                         Eigen::AngleAxisd(radians(angles.y()), Eigen::Vector3d::UnitY()) *
                         Eigen::AngleAxisd(radians(angles.x()), Eigen::Vector3d::UnitX());
    placement.rotation.normalize();
  }
  placement.scale = from.value("scale", 1.0);
  return placement;
}

Result<Model> read_shape(const Entry& from) {
  static const std::map<std::string, std::vector<std::string>> kMeasures = {
      {"box", {"size"}},
      {"sphere", {"radius"}},
      {"cylinder", {"radius", "height"}},
      {"ring", {"radius", "thickness"}}};
  const std::string kind = from["kind"].text();
  const std::vector<std::string>& measures = kMeasures.at(kind);
  for (const std::string& measure : measures) {
    if (!from.value.contains(measure))
      return from.fault("has no \"{}\"; a {} needs it", measure, kind);
  }
  for (const auto& [key, unused] : from.value.items()) {
    const bool used =
        key == "kind" || key == "color" || std::ranges::find(measures, key) != measures.end();
    if (!used) return from[key].fault("a {} has none; remove it", kind);
  }
  const auto length = [&from](const char* key) { return from.value.at(key).get<float>(); };
  Model model;
  if (kind == "box") {
    model = make_box(to_glm(vector_of(from.value.at("size"))));
  } else if (kind == "sphere") {
    model = make_sphere(length("radius"));
  } else if (kind == "cylinder") {
    model = make_cylinder(length("radius"), length("height"));
  } else {
    if (length("thickness") > 2.0F * length("radius")) {
      return from["thickness"].fault("is over twice the radius; make the ring thinner");
    }
    model = make_ring(length("radius"), length("thickness"));
  }
  if (model.triangle_count() == 0) return from.fault("is too small to have faces; make it larger");
  if (const auto color = from.find("color")) {
    model.materials[0].base_color = glm::vec4(to_glm(vector_of(color->value)), 1.0F);
  }
  return model;
}

Result<Sun> read_sun(const Entry& from) {
  Sun sun;
  sun.latitude_deg = from.value.at("latitude_deg").get<double>();
  sun.longitude_deg = from.value.at("longitude_deg").get<double>();
  sun.hours_per_s = from.value.value("hours_per_s", 0.0);
  sun.north_deg = from.value.value("north_deg", 0.0);
  // The schema ensures digits: "2026-06-21", "10:30".
  const auto number = [](const std::string& text, std::size_t at, std::size_t length) {
    return std::stoi(text.substr(at, length));
  };
  const std::string date = from["date"].text();
  const std::string time = from["time_utc"].text();
  const std::chrono::year_month_day day(
      std::chrono::year(number(date, 0, 4)),
      std::chrono::month(static_cast<unsigned>(number(date, 5, 2))),
      std::chrono::day(static_cast<unsigned>(number(date, 8, 2))));
  if (!day.ok()) return from["date"].fault("is \"{}\", not a day of the calendar", date);
  const int hour = number(time, 0, 2);
  const int minute = number(time, 3, 2);
  if (hour > 23 || minute > 59) {
    return from["time_utc"].fault("is \"{}\"; give 00:00 to 23:59", time);
  }
  sun.start_utc_s =
      86400.0 * static_cast<double>(std::chrono::sys_days(day).time_since_epoch().count()) +
      3600.0 * hour + 60.0 * minute;
  return sun;
}

Result<LayeredConstants> read_layered(const Entry& from) {
  // The schema allows only the string "inf"; an absent number is 0.
  const auto number = [&from](const char* key) {
    const auto found = from.value.find(key);
    if (found == from.value.end()) return 0.0;
    return found->is_string() ? std::numeric_limits<double>::infinity() : found->get<double>();
  };
  using Keys = std::set<std::string>;
  Keys keys;
  for (const auto& [key, unused] : from.value.items()) keys.insert(key);
  Result<LayeredConstants> constants;
  if (keys == Keys{"workspace_height", "magnification"}) {
    constants =
        layered_constants_for_workspace(number("workspace_height"), number("magnification"));
  } else if (keys == Keys{"light_height", "light_ratio"} ||
             keys == Keys{"light_height", "umbra_height"}) {
    constants = make_layered_constants(number("light_height"), number("light_ratio"),
                                       number("umbra_height"));
  } else {
    return from.fault(
        "give light_height with light_ratio or umbra_height, or workspace_height with "
        "magnification");
  }
  if (!constants) return fail_in(from.place, constants.error());
  return constants;
}

UpAxis up_axis_of(const json& object) {
  return value_named(kUpAxisNames, object.value("up", "")).value_or(UpAxis::by_format);
}

// Returns the entry with the name or index of an animation of the object's model.
std::optional<Entry> model_animation_of(const Entry& object) {
  const auto animation = object.find("animation");
  if (!animation || !animation->value.is_object()) return animation;
  return animation->find("model");
}

class SceneReader {
 public:
  explicit SceneReader(const std::filesystem::path& file) : file_(file), name_(file.string()) {}

  [[nodiscard]] Result<Scene> read(const json& root);

 private:
  [[nodiscard]] Result<void> read_object(const Entry& from, bool phantom);
  [[nodiscard]] Result<std::shared_ptr<const Model>> read_model(const Entry& from,
                                                                std::string& model_file);
  // `file`: the entry with the model's file name.
  [[nodiscard]] std::filesystem::path path_of(const Entry& file) const {
    return (file_.parent_path() / file.text()).lexically_normal();
  }
  [[nodiscard]] Result<std::shared_ptr<const Model>> load(const Entry& file, const json& object,
                                                          std::string& model_file);
  // Reads an animation of the model's file and the object's shape at time 0. `animation`: its name
  // or index.
  [[nodiscard]] Result<void> read_playback(const Entry& from, const Entry& animation,
                                           SceneObject& object);
  [[nodiscard]] Result<void> read_casting(const Entry& from, SceneObject& object);
  [[nodiscard]] Result<Animation> read_animation(const Entry& from);
  [[nodiscard]] Result<void> read_plane(const Entry& from);
  [[nodiscard]] Result<void> read_light(const Entry& from);
  [[nodiscard]] Result<void> read_shadow(const Entry& from);
  void warn(std::string_view place, std::string_view text) {
    scene_.warnings.push_back(fmt::format("{}: {}: {}", name_, place, text));
  }
  void warn_of_size(const SceneObject& object);
  void warn_of_distance(const SceneObject& object);
  void warn_of_lights();
  // Adds advice about the node being read.
  void advise(std::string_view place, std::string_view text) {
    scene_.layered_advice.push_back(
        {static_cast<int>(scene_.shadows.size()), fmt::format("{}: {}: {}", name_, place, text)});
  }
  void advise_on_size(const ShadowNode& node, std::string_view place);
  void advise_on_height(const ShadowNode& node, const Entry& from);

  std::filesystem::path file_;
  std::string name_;
  Scene scene_;
  std::map<std::string, std::shared_ptr<const Model>> models_;
  std::map<std::string, std::shared_ptr<const AnimatedModel>> animated_models_;
  std::set<std::string> odd_sizes_;   // files of models with a size warning
  std::set<std::string> far_models_;  // files of models with a distance warning
};

Result<std::shared_ptr<const Model>> SceneReader::read_model(const Entry& from,
                                                             std::string& model_file) {
  const auto shape = from.find("shape");
  if (from.value.contains("model") == shape.has_value()) {
    return from.fault("needs a \"model\" or a \"shape\"; give one of them");
  }
  if (!shape) return load(from["model"], from.value, model_file);
  if (const auto up = from.find("up")) return up->fault("is for models; remove it");
  PENUMBRA_TRY(Model model, read_shape(*shape));
  return std::make_shared<const Model>(std::move(model));
}

Result<std::shared_ptr<const Model>> SceneReader::load(const Entry& file, const json& object,
                                                       std::string& model_file) {
  const std::filesystem::path path = path_of(file);
  model_file = path.string();
  const UpAxis up = up_axis_of(object);
  const std::string key = fmt::format("{} {}", static_cast<int>(up), model_file);
  std::shared_ptr<const Model>& known = models_[key];
  if (known == nullptr) {
    Result<Model> model = load_model(path, {.up = up});
    if (!model) return fail_in(file.place, model.error());
    known = std::make_shared<const Model>(std::move(*model));
    scene_.warnings.insert(scene_.warnings.end(), known->warnings.begin(), known->warnings.end());
  }
  return known;
}

Result<void> SceneReader::read_playback(const Entry& from, const Entry& animation,
                                        SceneObject& object) {
  const auto file = from.find("model");
  if (!file) return animation.fault("is for animations of a model; a shape has none");
  const std::filesystem::path path = path_of(*file);
  object.model_file = path.string();
  const UpAxis up = up_axis_of(from.value);
  const std::string chosen =
      animation.value.is_string() ? animation.text() : animation.value.dump();
  const std::string key = fmt::format("{} {} {}", static_cast<int>(up), chosen, object.model_file);
  std::shared_ptr<const AnimatedModel>& known = animated_models_[key];
  const bool is_new = known == nullptr;
  if (is_new) {
    auto model = AnimatedModel::load(path, chosen, {.up = up});
    if (!model) return fail_in(animation.place, model.error());
    known = std::move(*model);
  }
  Playback& playback = object.playback;
  playback.model = known;
  playback.animation = chosen;
  playback.speed = from.value.value("speed", playback.speed);
  playback.start_s = from.value.value("start", playback.start_s);
  playback.loop = from.value.value("loop", playback.loop);
  auto shape = known->at(playback.time_at(0.0));
  if (!shape) return fail_in(animation.place, shape.error());
  object.model = std::move(*shape);
  const std::vector<std::string>& warnings = object.model->warnings;
  if (is_new) scene_.warnings.insert(scene_.warnings.end(), warnings.begin(), warnings.end());
  return {};
}

// Reads the groups of parts that share a light, and the proxy model.
Result<void> SceneReader::read_casting(const Entry& from, SceneObject& object) {
  const Model& model = *object.model;
  if (const auto group = from.find("group")) {
    if (group->value.is_string()) {
      object.groups = {group->text()};
    } else {
      object.groups = group->value.get<std::vector<std::string>>();
    }
    const Result<void> checked = check_groups(model, object.groups);
    if (!checked) return fail_in(group->place, checked.error());
    if (model.shadow_kernel_up &&
        !stored_kernels_fit(model, make_shadow_mesh(model, object.groups), object.groups)) {
      warn(group->place,
           "the model's stored shadow kernels are for other parts; they are computed again");
    }
  }
  const auto proxy = from.find("proxy");
  if (!proxy || proxy->text() == "none" || proxy->text() == "auto") return {};
  if (object.playback.model) {
    return proxy->fault("does not follow the animation of the model; remove one of them");
  }
  std::string ignored;
  PENUMBRA_TRY(object.proxy_model, load(*proxy, from.value, ignored));
  // Model and proxy share one placement.
  if (object.proxy_model->origin != model.origin) {
    auto moved = std::make_shared<Model>(*object.proxy_model);
    move_origin(*moved, model.origin);
    object.proxy_model = std::move(moved);
  }
  return {};
}

Result<Animation> SceneReader::read_animation(const Entry& from) {
  Animation animation;
  animation.loop = from.value.value("loop", true);
  if (from.value.value("interpolation", "smooth") == "linear") {
    animation.interpolation = Animation::Interpolation::linear;
  }
  if (const auto spin = from.find("spin")) {
    animation.spin_turns_per_s = spin->value.at("turns_per_s").get<double>();
    if (const auto axis = spin->find("axis")) {
      PENUMBRA_TRY(animation.spin_axis, direction_of(*axis));
    }
  }
  const auto keys = from.find("keyframes");
  if (!keys) return animation;
  for (std::size_t i = 0; i < keys->value.size(); ++i) {
    const json& key = keys->value[i];
    const double time = key.at("time_s").get<double>();
    if (i > 0 && !(time >= animation.keyframes.back().time_s + kMinKeySpacing_s)) {
      return fail("{}/{}/time_s: is {}, not after the key before; put the keys in order of time",
                  keys->place, i, time);
    }
    animation.keyframes.push_back({time, placement_of(key)});
  }
  const Placement& first = animation.keyframes.front().placement;
  const Placement& last = animation.keyframes.back().placement;
  const bool closed = (first.position - last.position).norm() < 1e-6 &&
                      first.rotation.angularDistance(last.rotation) < 1e-6 &&
                      std::abs(first.scale - last.scale) < 1e-6;
  if (animation.loop && !closed) {
    warn(keys->place, "the loop jumps; make the last key like the first");
  }
  return animation;
}

// Warns once per model.
void SceneReader::warn_of_size(const SceneObject& object) {
  // A phantom may be a wall.
  if (object.phantom || object.model_file.empty() || odd_sizes_.contains(object.model_file)) return;
  const auto warning = warning_of_size(
      *object.model, {.scale = object.placement.scale, .remedy = SizeRemedy::scene_scale},
      fmt::format("{}: \"{}\"", object.model_file, shortened(object.name)));
  if (!warning) return;
  odd_sizes_.insert(object.model_file);
  scene_.warnings.push_back(*warning);
}

// Warns once per model; not for objects with keyframes, which may move them anywhere.
void SceneReader::warn_of_distance(const SceneObject& object) {
  constexpr double kMaxDistance_m = 100.0;
  if (object.model_file.empty() || !object.animation.keyframes.empty()) return;
  Placement T_table_object = object.placement;
  for (int parent = object.parent; parent >= 0;) {
    const SceneObject& above = scene_.objects[static_cast<std::size_t>(parent)];
    T_table_object = above.placement * T_table_object;
    parent = above.parent;
  }
  const Model& model = *object.model;
  const Eigen::Vector3d middle =
      placed_model(model, T_table_object) *
      Eigen::Vector3d(0.5 * (to_eigen(model.min_corner) + to_eigen(model.max_corner)));
  if (middle.norm() <= kMaxDistance_m || !far_models_.insert(object.model_file).second) return;
  const Eigen::Vector3d position = object.placement.position - middle;
  const bool is_allowed = position.cwiseAbs().maxCoeff() <= 1000.0;  // limit of the schema
  std::string remedy = "move it to the origin in its file and export it again";
  if (object.parent >= 0) {
    remedy = "change its position or its parent's";
  } else if (is_allowed) {
    remedy = fmt::format("position [{:.10g}, {:.10g}, {:.10g}] brings its middle there",
                         position.x(), position.y(), position.z());
  }
  scene_.warnings.push_back(fmt::format("{}: \"{}\": lies {:.4g} m from the table's origin; {}",
                                        object.model_file, shortened(object.name), middle.norm(),
                                        remedy));
}

Result<void> SceneReader::read_object(const Entry& from, bool phantom) {
  SceneObject object;
  object.phantom = phantom;
  PENUMBRA_TRY(object.name, new_name(from, scene_.objects));
  if (const auto parent = from.find("parent")) {
    object.parent = index_of(scene_.objects, parent->text());
    if (object.parent < 0) {
      return parent->fault("no object before this one is called \"{}\"; {}",
                           shortened(parent->text()),
                           suggestion_from(scene_.objects, parent->text()));
    }
  }
  if (const auto group = from.find("tag_group")) {
    if (object.parent >= 0) return group->fault("the parent says what it moves with; remove it");
    object.tag_group = group->text();
  }
  if (const auto animation = model_animation_of(from)) {
    PENUMBRA_TRY_VOID(read_playback(from, *animation, object));
  } else {
    for (const char* key : {"speed", "loop", "start"}) {
      if (!from.value.contains(key)) continue;
      return from[key].fault("is for an animation of the model; give its name as \"animation\"");
    }
    PENUMBRA_TRY(object.model, read_model(from, object.model_file));
  }
  PENUMBRA_TRY_VOID(read_casting(from, object));
  object.placement = placement_of(from.value);
  warn_of_size(object);
  // The video already shows the shadow of a real object.
  object.casts_shadow = from.value.value("casts_shadow", !phantom);
  object.cursor = from.value.value("cursor", false);
  if (object.cursor) {
    const Entry cursor = from["cursor"];
    if (phantom) return cursor.fault("is for virtual objects; remove it");
    if (object.parent >= 0 || object.tag_group != kTableGroup) {
      return cursor.fault("moves freely over the table; remove its parent or tag_group");
    }
    if (std::ranges::find(scene_.objects, true, &SceneObject::cursor) != scene_.objects.end()) {
      return cursor.fault("the scene has another 3D cursor already; keep one");
    }
  }
  if (const auto animation = from.find("animation"); animation && animation->value.is_object()) {
    PENUMBRA_TRY(object.animation, read_animation(*animation));
  }
  warn_of_distance(object);
  scene_.objects.push_back(std::move(object));
  return {};
}

Result<void> SceneReader::read_plane(const Entry& from) {
  ScenePlane plane;
  PENUMBRA_TRY(plane.name, new_name(from, scene_.planes));
  if (const auto normal = from.find("normal")) {
    PENUMBRA_TRY(plane.normal, direction_of(*normal));
  }
  plane.point = vector_or(from.value, "point", plane.point);
  plane.tag_group = from.value.value("tag_group", plane.tag_group);
  if (const auto outline = from.find("outline")) {
    for (const json& corner : outline->value) {
      plane.outline.emplace_back(corner[0].get<double>(), corner[1].get<double>());
    }
    double doubled_area = 0.0;
    for (std::size_t i = 0; i < plane.outline.size(); ++i) {
      const Eigen::Vector2d& a = plane.outline[i];
      const Eigen::Vector2d& b = plane.outline[(i + 1) % plane.outline.size()];
      doubled_area += a.x() * b.y() - b.x() * a.y();
    }
    if (std::abs(doubled_area) < 1e-12) {
      return outline->fault("has no area; give the corners in their order");
    }
  }
  scene_.planes.push_back(std::move(plane));
  return {};
}

Result<void> SceneReader::read_light(const Entry& from) {
  SceneLight light;
  PENUMBRA_TRY(light.name, new_name(from, scene_.lights));
  const std::string kind = from["kind"].text();
  const std::string needed = kind == "directional" ? "direction"
                             : kind == "sun"       ? "sun"
                                                   : "position";
  if (!from.value.contains(needed)) {
    return from.fault("has no \"{}\"; a {} light needs it", needed, kind);
  }
  for (const char* useless : {"position", "direction", "sun"}) {
    if (useless != needed && from.value.contains(useless)) {
      return from[useless].fault("a {} light has none; remove it", kind);
    }
  }
  const auto animation = from.find("animation");
  if (animation && (!animation->value.is_object() || animation->value.contains("model"))) {
    return animation->fault(
        "names an animation of a model, which a light has not; give keyframes "
        "or a spin");
  }
  if (kind == "sun" && animation) {
    return animation->fault(
        "the sun's direction comes from its time; give hours_per_s in place of an animation");
  }
  light.kind = kind == "point" ? SceneLight::Kind::point : SceneLight::Kind::directional;
  light.position = vector_or(from.value, "position", light.position);
  if (const auto direction = from.find("direction")) {
    PENUMBRA_TRY(light.direction, direction_of(*direction, "the direction to the light"));
  }
  if (const auto sun = from.find("sun")) {
    PENUMBRA_TRY(light.sun, read_sun(*sun));
  }
  if (animation) {
    PENUMBRA_TRY(light.animation, read_animation(*animation));
  }
  light.color = vector_or(from.value, "color", light.color);
  light.intensity = from.value.value("intensity", 1.0);
  scene_.lights.push_back(std::move(light));
  return {};
}

// Advises if a penumbra is too large for its plane. Layered Penumbrae, section 5.1: at the height
// where the umbra vanishes, the penumbra is 2 M times as large as the object, M = a / (a - 1), with
// the light ratio a. It fits onto the plane if M <= W / (2 r), where W is half the width of the
// plane's outline and r the radius of the object's footprint at time 0.
void SceneReader::advise_on_size(const ShadowNode& node, std::string_view place) {
  const double ratio = node.layered.light_ratio;
  if (!(ratio > 1.0)) return;
  const double magnification = std::isinf(ratio) ? 1.0 : ratio / (ratio - 1.0);
  const SceneState start = evaluate_scene(scene_, 0.0);
  for (const int index : node.planes) {
    const ScenePlane& plane = scene_.planes[static_cast<std::size_t>(index)];
    if (plane.outline.empty()) continue;
    Eigen::AlignedBox2d sheet;
    for (const Eigen::Vector2d& corner : plane.outline) sheet.extend(corner);
    const double half_width = 0.5 * sheet.sizes().minCoeff();
    const PlaneFrame frame = PlaneFrame::make(plane.normal, plane.point);
    const SceneObject* widest = nullptr;
    double radius = 0.0;
    for (const int caster : node.casters) {
      const SceneObject& object = scene_.objects[static_cast<std::size_t>(caster)];
      if (!object.model) continue;
      const Eigen::AlignedBox3d box(to_eigen(object.model->min_corner),
                                    to_eigen(object.model->max_corner));
      const Placement T =
          placed_model(*object.model, start.objects[static_cast<std::size_t>(caster)]);
      Eigen::AlignedBox2d footprint;
      for (int i = 0; i < 8; ++i) {
        const auto corner = static_cast<Eigen::AlignedBox3d::CornerType>(i);
        footprint.extend(frame.to_plane(T * box.corner(corner)).head<2>());
      }
      const double object_radius = 0.5 * footprint.diagonal().norm();
      if (widest == nullptr || object_radius > radius) {
        widest = &object;
        radius = object_radius;
      }
    }
    if (widest == nullptr || magnification <= half_width / (2.0 * radius)) continue;
    const double limit = half_width / (2.0 * radius);
    const std::string remedy =
        limit > 1.0
            ? fmt::format(
                  "give a magnification of {:.2f} or less (a light_ratio of {:.1f} or more)", limit,
                  limit / (limit - 1.0))
            : "lower the height at which it vanishes, or take a smaller object";
    advise(place, fmt::format("where its umbra vanishes the penumbra of \"{}\" is {:.2g} m wide, "
                              "and the plane \"{}\" {:.2g} m; {}",
                              shortened(widest->name), 4.0 * magnification * radius,
                              shortened(plane.name), 2.0 * half_width, remedy));
  }
}

// Advises if an object rises above the heights that cast shadows, or above the workspace, where it
// has no umbra. From the image alone, a user can't know why the shadow or the umbra is missing.
void SceneReader::advise_on_height(const ShadowNode& node, const Entry& from) {
  const auto layered = from.find("layered");
  const bool by_workspace = layered && layered->value.contains("workspace_height");
  const double max_casting_height = layer_height_range(node.layered, ShadowLayer::penumbra).high;
  for (const int index : node.planes) {
    const ScenePlane& plane = scene_.planes[static_cast<std::size_t>(index)];
    // Excludes planes that move with other tags, and walls, because most of the scene is far in
    // front of them.
    const bool is_floor = std::abs(plane.normal.z()) > 0.5 && plane.tag_group == kTableGroup;
    if (!is_floor) continue;
    const std::vector<double> tops = vertex_heights(scene_, plane.normal, plane.point);
    for (const int caster : node.casters) {
      const SceneObject& object = scene_.objects[static_cast<std::size_t>(caster)];
      if (object.tag_group != kTableGroup) continue;  // moves with its tags
      const double top = tops[static_cast<std::size_t>(caster)];
      const std::string above = fmt::format("\"{}\" comes to {:.4g} m above \"{}\"",
                                            shortened(object.name), top, shortened(plane.name));
      if (top > max_casting_height) {
        advise(from.place, fmt::format("{}; what is above {:.4g} m casts nothing; lower it, or "
                                       "raise the light or workspace_height",
                                       above, max_casting_height));
      } else if (by_workspace && top > node.layered.umbra_height * (1.0 + 1e-6)) {
        advise(from.place,
               fmt::format("{}, beyond the workspace_height of {:.4g} m, and has no umbra there; "
                           "give the highest place that objects come to",
                           above, node.layered.umbra_height));
      }
    }
  }
}

// Warns of too many lights: each light's projected shadows on a plane need a stencil bit.
void SceneReader::warn_of_lights() {
  std::map<int, std::set<int>> lights_on;
  for (const ShadowNode& node : scene_.shadows) {
    if (node.technique != ShadowTechnique::hard) continue;
    for (const int plane : node.planes) {
      lights_on[plane].insert(node.lights.begin(), node.lights.end());
    }
  }
  for (const auto& [plane, lights] : lights_on) {
    if (lights.size() <= kMaxHardLights) continue;
    warn("/shadows",
         fmt::format("{} lights cast projected shadows onto \"{}\", which shows those of {}; the "
                     "others' are skipped: name fewer of them, or take the technique \"volume\"",
                     lights.size(), shortened(scene_.planes[static_cast<std::size_t>(plane)].name),
                     kMaxHardLights));
  }
}

Result<void> SceneReader::read_shadow(const Entry& from) {
  ShadowNode node;
  PENUMBRA_TRY(node.name, new_name(from, scene_.shadows));
  // The schema ensures known words.
  node.technique = value_named(kShadowTechniqueNames, from["technique"].text()).value();
  if (const auto kernels = from.find("kernels")) {
    node.kernels = value_named(kKernelSourceNames, kernels->text()).value();
  }
  if (const auto mode = from.find("light_mode")) {
    node.light_mode = value_named(kLightModeNames, mode->text()).value();
    if (node.light_mode == LightMode::fixed && node.kernels == KernelSource::centroid) {
      return mode->fault("is \"fixed\", which needs kernels with a thickness; cocl has none");
    }
  }
  std::vector<int> casters(scene_.objects.size());
  std::iota(casters.begin(), casters.end(), 0);
  if (const auto names = from.find("casters")) {
    PENUMBRA_TRY(casters, indices_of(*names, scene_.objects, "object"));
  }
  // An object's casts_shadow overrides the node's list.
  std::ranges::copy_if(casters, std::back_inserter(node.casters), [this](int caster) {
    return scene_.objects[static_cast<std::size_t>(caster)].casts_shadow;
  });
  node.planes = {0};
  if (const auto names = from.find("planes")) {
    PENUMBRA_TRY(node.planes, indices_of(*names, scene_.planes, "plane"));
  }
  if (const auto names = from.find("walls")) {
    PENUMBRA_TRY(node.walls, indices_of(*names, scene_.planes, "plane"));
    for (const int plane : node.planes) std::erase(node.walls, plane);
  } else {
    node.default_walls = true;
  }
  if (const auto names = from.find("lights")) {
    PENUMBRA_TRY(node.lights, indices_of(*names, scene_.lights, "light"));
  }
  node.light_rays = from.value.value("light_rays", false);
  node.contact = from.value.value("contact", false);
  if (const auto layered = from.find("layered")) {
    PENUMBRA_TRY(node.layered, read_layered(*layered));
    if (std::isfinite(node.layered.light_height) && node.layered.light_ratio <= 1.0) {
      warn(layered->place,
           "with a light_ratio of 1 or less the umbra never vanishes; give more than 1");
    }
  }
  if (traits_of(node.technique).has_penumbra) {
    advise_on_size(node, from.place);
    advise_on_height(node, from);
  }
  if (const auto light_left = from.find("light_left")) {
    LightFractions& fractions = node.fractions;
    fractions.umbra = light_left->value.value("umbra", fractions.umbra);
    fractions.middle = light_left->value.value("middle", fractions.middle);
    fractions.penumbra = light_left->value.value("penumbra", fractions.penumbra);
    if (!(fractions.umbra <= fractions.middle && fractions.middle <= fractions.penumbra)) {
      warn(light_left->place, "the umbra should be darkest and the penumbra lightest");
    }
  }
  scene_.shadows.push_back(std::move(node));
  return {};
}

Result<Scene> SceneReader::read(const json& root) {
  scene_.file = name_;
  scene_.name = root.value("name", file_.stem().string());
  scene_.ambient = vector_or(root, "ambient", scene_.ambient);
  const auto each = [&root](const char* key, const auto& read) -> Result<void> {
    const auto list = root.find(key);
    for (std::size_t i = 0; list != root.end() && i < list->size(); ++i) {
      PENUMBRA_TRY_VOID(read(Entry{(*list)[i], fmt::format("/{}/{}", key, i)}));
    }
    return {};
  };
  PENUMBRA_TRY_VOID(
      each("objects", [this](const Entry& from) { return read_object(from, false); }));
  PENUMBRA_TRY_VOID(
      each("phantoms", [this](const Entry& from) { return read_object(from, true); }));
  PENUMBRA_TRY_VOID(each("planes", [this](const Entry& from) { return read_plane(from); }));
  if (scene_.planes.empty()) scene_.planes.emplace_back().name = "table";
  PENUMBRA_TRY_VOID(each("lights", [this](const Entry& from) { return read_light(from); }));
  PENUMBRA_TRY_VOID(each("shadows", [this](const Entry& from) { return read_shadow(from); }));
  if (!scene_.objects.empty() && !root.contains("shadows")) {
    scene_.warnings.push_back(
        fmt::format("{}: has no shadow node, so nothing casts a shadow; add \"shadows\": "
                    "[{{\"name\": \"shadow\", \"technique\": \"layered\"}}], or [] to have none",
                    name_));
  }
  warn_of_lights();
  for (ShadowNode& node : scene_.shadows) {
    if (node.default_walls) add_default_walls(scene_, node);
  }
  return std::move(scene_);
}

}  // namespace

Result<Scene> load_scene(const std::filesystem::path& file) {
  std::string content;
  PENUMBRA_TRY(const json root, read_scene_json(file, &content));
  try {
    Result<Scene> scene = SceneReader(file).read(root);
    if (!scene) return fail_in(file.string(), scene.error());
    scene->json = std::make_shared<const std::string>(std::move(content));
    return scene;
  } catch (const std::exception& error) {
    return fail("{}: can't be read: {}", file.string(), error.what());
  }
}

}  // namespace penumbra
