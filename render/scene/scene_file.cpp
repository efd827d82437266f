// JSON scene -> Scene. scene_json.cpp reads it and checks it against the schema; what a schema
// can't say (names that must exist, keys that go together) is checked here.
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "core/propagate.hpp"
#include "core/units.hpp"
#include "render/model/kernel_stamp.hpp"
#include "render/model/model_size.hpp"
#include "render/model/part_groups.hpp"
#include "render/model/to_eigen.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/scene/scene_json.hpp"
#include "render/scene/shapes.hpp"

namespace penumbra {
namespace {

using nlohmann::json;

constexpr double kShortestKey_s = 1e-6;
// --- JSON -> Scene ---

class SceneReader {
 public:
  explicit SceneReader(const std::filesystem::path& file) : file_(file), name_(file.string()) {}

  [[nodiscard]] Result<Scene> read(const json& root);

 private:
  template <class... Args>
  [[nodiscard]] tl::unexpected<Error> fail_at(const std::string& pointer,
                                              fmt::format_string<Args...> text,
                                              Args&&... args) const {
    return fail("{}: {}: {}", name_, pointer, fmt::format(text, std::forward<Args>(args)...));
  }

  void warn_of_size(const SceneObject& object);
  void warn_of_distance(const SceneObject& object);
  [[nodiscard]] Result<void> read_object(const json& from, const std::string& pointer,
                                         bool phantom);
  [[nodiscard]] Result<std::shared_ptr<const Model>> read_model(const json& from,
                                                                const std::string& pointer,
                                                                std::string& model_file);
  [[nodiscard]] Result<std::shared_ptr<const Model>> model_from(const std::string& given,
                                                                const json& object,
                                                                const std::string& pointer,
                                                                std::string& model_file);
  [[nodiscard]] Result<void> read_casting(const json& from, const std::string& pointer,
                                          SceneObject& object);
  [[nodiscard]] Result<Model> read_shape(const json& from, const std::string& pointer) const;
  [[nodiscard]] Result<Animation> read_animation(const json& from, const std::string& pointer);
  [[nodiscard]] Result<void> read_plane(const json& from, const std::string& pointer);
  [[nodiscard]] Result<void> read_light(const json& from, const std::string& pointer);
  [[nodiscard]] Result<Sun> read_sun(const json& from, const std::string& pointer) const;
  [[nodiscard]] Result<void> read_shadow(const json& from, const std::string& pointer);
  [[nodiscard]] Result<LayeredConstants> read_layered(const json& from,
                                                      const std::string& pointer) const;
  void advise_on_size(const ShadowNode& node, const std::string& pointer);
  void advise_on_lights();
  // Of the node that is read now.
  void advise(std::string text) {
    scene_.layered_advice.push_back({static_cast<int>(scene_.shadows.size()), std::move(text)});
  }
  void advise_on_height(const ShadowNode& node, const std::string& pointer, bool by_workspace);
  template <class List>
  [[nodiscard]] Result<std::vector<int>> indices_of(const json& names, const List& list,
                                                    const std::string& pointer,
                                                    std::string_view kind) const;
  template <class List>
  [[nodiscard]] Result<void> check_new_name(const std::string& given, const List& list,
                                            const std::string& pointer) const;

  std::filesystem::path file_;
  std::string name_;
  Scene scene_;
  std::map<std::string, std::shared_ptr<const Model>> models_;
  std::set<std::string> odd_sizes_;          // files of models that were warned of
  std::set<std::string> far_models_;         // the same, for their places
  std::vector<std::size_t> unwalled_nodes_;  // shadow nodes that leave their walls to us
};

Eigen::Vector3d vector_of(const json& from) {
  return {from[0].get<double>(), from[1].get<double>(), from[2].get<double>()};
}

template <class List>
std::vector<std::string> names_of(const List& list) {
  std::vector<std::string> names;
  for (const auto& entry : list) names.push_back(entry.name);
  return names;
}

template <class List>
int index_of(const List& list, const std::string& name) {
  const auto found = std::find_if(list.begin(), list.end(),
                                  [&name](const auto& entry) { return entry.name == name; });
  return found == list.end() ? -1 : static_cast<int>(found - list.begin());
}

// About x, then y, then z of the parent.
Placement placement_of(const json& from) {
  Placement placement;
  if (const auto at = from.find("position"); at != from.end()) placement.position = vector_of(*at);
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

template <class List>
Result<void> SceneReader::check_new_name(const std::string& given, const List& list,
                                         const std::string& pointer) const {
  if (index_of(list, given) >= 0) {
    return fail_at(pointer + "/name", "\"{}\" is taken; give each its own name", shortened(given));
  }
  return {};
}

template <class List>
Result<std::vector<int>> SceneReader::indices_of(const json& names, const List& list,
                                                 const std::string& pointer,
                                                 std::string_view kind) const {
  std::vector<int> indices;
  for (std::size_t i = 0; i < names.size(); ++i) {
    const std::string name = names[i].get<std::string>();
    const int index = index_of(list, name);
    const std::string place = fmt::format("{}/{}", pointer, i);
    if (index < 0) {
      return fail_at(place, "there is no {} \"{}\"; {}", kind, shortened(name),
                     suggestion(name, names_of(list)));
    }
    if (std::find(indices.begin(), indices.end(), index) != indices.end()) {
      return fail_at(place, "\"{}\" is named twice; name it once", shortened(name));
    }
    indices.push_back(index);
  }
  return indices;
}

Result<Model> SceneReader::read_shape(const json& from, const std::string& pointer) const {
  static const std::map<std::string, std::vector<std::string>> kMeasures = {
      {"box", {"size"}},
      {"sphere", {"radius"}},
      {"cylinder", {"radius", "height"}},
      {"ring", {"radius", "thickness"}}};
  const std::string kind = from.at("kind").get<std::string>();
  const std::vector<std::string>& measures = kMeasures.at(kind);
  for (const std::string& measure : measures) {
    if (!from.contains(measure)) {
      return fail_at(pointer, "has no \"{}\"; a {} needs it", measure, kind);
    }
  }
  for (const auto& [key, unused] : from.items()) {
    const bool used = key == "kind" || key == "color" ||
                      std::find(measures.begin(), measures.end(), key) != measures.end();
    if (!used) return fail_at(pointer + "/" + key, "a {} has none; remove it", kind);
  }
  const auto length = [&from](const char* key) { return from.at(key).get<float>(); };
  Model model;
  if (kind == "box") {
    const json& size = from.at("size");
    model = make_box({size[0].get<float>(), size[1].get<float>(), size[2].get<float>()});
  } else if (kind == "sphere") {
    model = make_sphere(length("radius"));
  } else if (kind == "cylinder") {
    model = make_cylinder(length("radius"), length("height"));
  } else {
    if (length("thickness") > 2.0F * length("radius")) {
      return fail_at(pointer + "/thickness", "is over twice the radius; make the ring thinner");
    }
    model = make_ring(length("radius"), length("thickness"));
  }
  if (model.triangle_count() == 0) {
    return fail_at(pointer, "is too small to have faces; make it larger");
  }
  if (const auto color = from.find("color"); color != from.end()) {
    const Eigen::Vector3f rgb = vector_of(*color).cast<float>();
    model.materials[0].base_color = glm::vec4(rgb.x(), rgb.y(), rgb.z(), 1.0F);
  }
  return model;
}

Result<std::shared_ptr<const Model>> SceneReader::read_model(const json& from,
                                                             const std::string& pointer,
                                                             std::string& model_file) {
  if (from.contains("model") == from.contains("shape")) {
    return fail_at(pointer, "needs a \"model\" or a \"shape\"; give one of them");
  }
  if (from.contains("shape")) {
    if (from.contains("up")) return fail_at(pointer + "/up", "is for models; remove it");
    PENUMBRA_TRY(Model shape, read_shape(from.at("shape"), pointer + "/shape"));
    return std::make_shared<const Model>(std::move(shape));
  }
  return model_from(from.at("model").get<std::string>(), from, pointer + "/model", model_file);
}

Result<std::shared_ptr<const Model>> SceneReader::model_from(const std::string& given,
                                                             const json& object,
                                                             const std::string& pointer,
                                                             std::string& model_file) {
  const std::filesystem::path path = (file_.parent_path() / given).lexically_normal();
  model_file = path.string();
  UpAxis up = UpAxis::by_format;
  if (object.contains("up")) up = object.at("up") == "y" ? UpAxis::y : UpAxis::z;
  const std::string key = fmt::format("{} {}", static_cast<int>(up), model_file);
  std::shared_ptr<const Model>& known = models_[key];
  if (known == nullptr) {
    Result<Model> model = load_model(path, {.up = up});
    if (!model) return fail_at(pointer, "{}", model.error().message);
    known = std::make_shared<const Model>(std::move(*model));
    scene_.warnings.insert(scene_.warnings.end(), known->warnings.begin(), known->warnings.end());
  }
  return known;
}

// What the object's shadow is made of: groups and proxy.
Result<void> SceneReader::read_casting(const json& from, const std::string& pointer,
                                       SceneObject& object) {
  if (const auto group = from.find("group"); group != from.end()) {
    if (group->is_string()) {
      object.groups = {group->get<std::string>()};
    } else {
      object.groups = group->get<std::vector<std::string>>();
    }
    const Result<void> checked = check_groups(*object.model, object.groups);
    if (!checked) return fail_at(pointer + "/group", "{}", checked.error().message);
    if (object.model->shadow_kernel_up &&
        !stored_kernels_fit(*object.model, make_shadow_mesh(*object.model, object.groups),
                            object.groups)) {
      scene_.warnings.push_back(
          fmt::format("{}: {}/group: the model's stored shadow kernels are for other parts; they "
                      "are made anew",
                      scene_.file, pointer));
    }
  }
  const std::string proxy = from.value("proxy", std::string("auto"));
  if (proxy != "none" && proxy != "auto") {
    std::string ignored;
    PENUMBRA_TRY(std::shared_ptr<const Model> model,
                 model_from(proxy, from, pointer + "/proxy", ignored));
    object.proxy_model = std::move(model);
    // Both are drawn with one placement.
    if (object.proxy_model->origin != object.model->origin) {
      auto moved = std::make_shared<Model>(*object.proxy_model);
      move_origin(*moved, object.model->origin);
      object.proxy_model = std::move(moved);
    }
  }
  return {};
}

Result<Animation> SceneReader::read_animation(const json& from, const std::string& pointer) {
  Animation animation;
  animation.loop = from.value("loop", true);
  if (from.value("interpolation", std::string("smooth")) == "linear") {
    animation.interpolation = Animation::Interpolation::linear;
  }
  if (const auto spin = from.find("spin"); spin != from.end()) {
    animation.spin_turns_per_s = spin->at("turns_per_s").get<double>();
    if (const auto axis = spin->find("axis"); axis != spin->end()) {
      animation.spin_axis = vector_of(*axis);
      if (animation.spin_axis.norm() < 1e-9) {
        return fail_at(pointer + "/spin/axis", "has no length; give a direction");
      }
      animation.spin_axis.normalize();
    }
  }
  if (const auto keys = from.find("keyframes"); keys != from.end()) {
    for (std::size_t i = 0; i < keys->size(); ++i) {
      const json& key = (*keys)[i];
      const double time = key.at("time_s").get<double>();
      if (i > 0 && !(time >= animation.keyframes.back().time_s + kShortestKey_s)) {
        return fail_at(fmt::format("{}/keyframes/{}/time_s", pointer, i),
                       "is {}, not after the key before; put the keys in order of time", time);
      }
      animation.keyframes.push_back({time, placement_of(key)});
    }
    const Placement& first = animation.keyframes.front().placement;
    const Placement& last = animation.keyframes.back().placement;
    const bool closed = (first.position - last.position).norm() < 1e-6 &&
                        first.rotation.angularDistance(last.rotation) < 1e-6 &&
                        std::abs(first.scale - last.scale) < 1e-6;
    if (animation.loop && !closed) {
      scene_.warnings.push_back(fmt::format(
          "{}: {}/keyframes: the loop jumps; make the last key like the first", name_, pointer));
    }
  }
  return animation;
}

// Once per model.
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

// Once per model. Keyframes may bring an object anywhere.
void SceneReader::warn_of_distance(const SceneObject& object) {
  constexpr double kFarthest = 100.0;  // [m]
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
  if (middle.norm() <= kFarthest || !far_models_.insert(object.model_file).second) return;
  const Eigen::Vector3d position = object.placement.position - middle;
  const bool is_allowed = position.cwiseAbs().maxCoeff() <= 1000.0;  // by the schema
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

Result<void> SceneReader::read_object(const json& from, const std::string& pointer, bool phantom) {
  SceneObject object;
  object.name = from.at("name").get<std::string>();
  object.phantom = phantom;
  if (Result<void> checked = check_new_name(object.name, scene_.objects, pointer); !checked) {
    return checked;
  }
  if (const auto parent = from.find("parent"); parent != from.end()) {
    const std::string name = parent->get<std::string>();
    object.parent = index_of(scene_.objects, name);
    if (object.parent < 0) {
      return fail_at(pointer + "/parent", "no object before this one is called \"{}\"; {}",
                     shortened(name), suggestion(name, names_of(scene_.objects)));
    }
  }
  if (const auto group = from.find("tag_group"); group != from.end()) {
    if (object.parent >= 0) {
      return fail_at(pointer + "/tag_group", "the parent says what it moves with; remove it");
    }
    object.tag_group = group->get<std::string>();
  }
  PENUMBRA_TRY(std::shared_ptr<const Model> model, read_model(from, pointer, object.model_file));
  object.model = std::move(model);
  if (Result<void> read = read_casting(from, pointer, object); !read) return read;
  object.placement = placement_of(from);
  warn_of_size(object);
  // The shadow of a real thing is in the picture already.
  object.casts_shadow = from.value("casts_shadow", !phantom);
  object.cursor = from.value("cursor", false);
  if (object.cursor && phantom) {
    return fail_at(pointer + "/cursor", "is for virtual objects; remove it");
  }
  if (object.cursor && (object.parent >= 0 || object.tag_group != kTableGroup)) {
    return fail_at(pointer + "/cursor",
                   "moves freely over the table; remove its parent or tag_group");
  }
  if (object.cursor &&
      std::ranges::find(scene_.objects, true, &SceneObject::cursor) != scene_.objects.end()) {
    return fail_at(pointer + "/cursor", "the scene has another 3D cursor already; keep one");
  }
  if (const auto animation = from.find("animation"); animation != from.end()) {
    PENUMBRA_TRY(Animation read, read_animation(*animation, pointer + "/animation"));
    object.animation = std::move(read);
  }
  warn_of_distance(object);
  scene_.objects.push_back(std::move(object));
  return {};
}

Result<void> SceneReader::read_plane(const json& from, const std::string& pointer) {
  ScenePlane plane;
  plane.name = from.at("name").get<std::string>();
  if (Result<void> checked = check_new_name(plane.name, scene_.planes, pointer); !checked) {
    return checked;
  }
  if (const auto normal = from.find("normal"); normal != from.end()) {
    plane.normal = vector_of(*normal);
    if (plane.normal.norm() < 1e-9) {
      return fail_at(pointer + "/normal", "has no length; give a direction");
    }
    plane.normal.normalize();
  }
  if (const auto point = from.find("point"); point != from.end()) plane.point = vector_of(*point);
  plane.tag_group = from.value("tag_group", plane.tag_group);
  if (const auto outline = from.find("outline"); outline != from.end()) {
    double doubled_area = 0.0;
    for (std::size_t i = 0; i < outline->size(); ++i) {
      const json& a = (*outline)[i];
      const json& b = (*outline)[(i + 1) % outline->size()];
      plane.outline.emplace_back(a[0].get<double>(), a[1].get<double>());
      doubled_area +=
          a[0].get<double>() * b[1].get<double>() - b[0].get<double>() * a[1].get<double>();
    }
    if (std::abs(doubled_area) < 1e-12) {
      return fail_at(pointer + "/outline", "has no area; give the corners in their order");
    }
  }
  scene_.planes.push_back(std::move(plane));
  return {};
}

Result<void> SceneReader::read_light(const json& from, const std::string& pointer) {
  SceneLight light;
  light.name = from.at("name").get<std::string>();
  if (Result<void> checked = check_new_name(light.name, scene_.lights, pointer); !checked) {
    return checked;
  }
  const std::string kind = from.at("kind").get<std::string>();
  const std::string needed = kind == "directional" ? "direction"
                             : kind == "sun"       ? "sun"
                                                   : "position";
  if (!from.contains(needed)) {
    return fail_at(pointer, "has no \"{}\"; a {} light needs it", needed, kind);
  }
  for (const char* useless : {"position", "direction", "sun"}) {
    if (useless != needed && from.contains(useless)) {
      return fail_at(fmt::format("{}/{}", pointer, useless), "a {} light has none; remove it",
                     kind);
    }
  }
  if (kind == "sun" && from.contains("animation")) {
    return fail_at(pointer + "/animation",
                   "the sun goes its own way; give hours_per_s in its place");
  }
  if (kind == "point") {
    light.position = vector_of(from.at("position"));
  } else {
    light.kind = SceneLight::Kind::directional;
  }
  if (kind == "directional") {
    light.direction = vector_of(from.at("direction"));
    if (light.direction.norm() < 1e-9) {
      return fail_at(pointer + "/direction", "has no length; give the direction to the light");
    }
    light.direction.normalize();
  }
  if (kind == "sun") {
    PENUMBRA_TRY(Sun sun, read_sun(from.at("sun"), pointer + "/sun"));
    light.sun = sun;
  }
  if (const auto animation = from.find("animation"); animation != from.end()) {
    PENUMBRA_TRY(Animation read, read_animation(*animation, pointer + "/animation"));
    light.animation = std::move(read);
  }
  if (const auto color = from.find("color"); color != from.end()) light.color = vector_of(*color);
  light.intensity = from.value("intensity", 1.0);
  scene_.lights.push_back(std::move(light));
  return {};
}

Result<Sun> SceneReader::read_sun(const json& from, const std::string& pointer) const {
  Sun sun;
  sun.latitude_deg = from.at("latitude_deg").get<double>();
  sun.longitude_deg = from.at("longitude_deg").get<double>();
  sun.hours_per_s = from.value("hours_per_s", 0.0);
  sun.north_deg = from.value("north_deg", 0.0);
  // The schema has checked that these are digits: "2026-06-21", "10:30".
  const auto number = [](const std::string& text, std::size_t at, std::size_t length) {
    return std::stoi(text.substr(at, length));
  };
  const std::string date = from.at("date").get<std::string>();
  const std::string time = from.at("time_utc").get<std::string>();
  const std::chrono::year_month_day day(
      std::chrono::year(number(date, 0, 4)),
      std::chrono::month(static_cast<unsigned>(number(date, 5, 2))),
      std::chrono::day(static_cast<unsigned>(number(date, 8, 2))));
  if (!day.ok()) return fail_at(pointer + "/date", "is \"{}\", not a day of the calendar", date);
  const int hour = number(time, 0, 2);
  const int minute = number(time, 3, 2);
  if (hour > 23 || minute > 59) {
    return fail_at(pointer + "/time_utc", "is \"{}\"; give 00:00 to 23:59", time);
  }
  sun.start_utc_s =
      86400.0 * static_cast<double>(std::chrono::sys_days(day).time_since_epoch().count()) +
      3600.0 * hour + 60.0 * minute;
  return sun;
}

Result<LayeredConstants> SceneReader::read_layered(const json& from,
                                                   const std::string& pointer) const {
  const auto number = [&from](const char* key) {
    const auto found = from.find(key);
    return found == from.end()  ? 0.0
           : found->is_string() ? std::numeric_limits<double>::infinity()
                                : found->get<double>();
  };
  std::set<std::string> keys;
  for (const auto& [key, unused] : from.items()) keys.insert(key);
  Result<LayeredConstants> constants;
  if (keys == std::set<std::string>{"workspace_height", "magnification"}) {
    constants =
        layered_constants_for_workspace(number("workspace_height"), number("magnification"));
  } else if (keys == std::set<std::string>{"light_height", "light_ratio"} ||
             keys == std::set<std::string>{"light_height", "umbra_height"}) {
    constants = make_layered_constants(number("light_height"), number("light_ratio"),
                                       number("umbra_height"));
  } else {
    return fail_at(pointer,
                   "give light_height with light_ratio or umbra_height, or workspace_height with "
                   "magnification");
  }
  if (!constants) return fail_at(pointer, "{}", constants.error().message);
  return constants;
}

// Layered Penumbrae, section 5.1: where the umbra vanishes the middle layer is M = a / (a - 1)
// times as large as the object and the penumbra 2 M times, which should fit the sheet: M <= W / (2
// r). W: half the width of the plane's outline, r: the radius of the footprint as the scene begins.
void SceneReader::advise_on_size(const ShadowNode& node, const std::string& pointer) {
  if (node.technique != ShadowTechnique::layered && node.technique != ShadowTechnique::field)
    return;
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
      const glm::vec3& low = object.model->min_corner;
      const glm::vec3& high = object.model->max_corner;
      Eigen::AlignedBox2d footprint;
      for (unsigned i = 0; i < 8; ++i) {
        const Eigen::Vector3d corner(static_cast<double>((i & 1U) != 0U ? high.x : low.x),
                                     static_cast<double>((i & 2U) != 0U ? high.y : low.y),
                                     static_cast<double>((i & 4U) != 0U ? high.z : low.z));
        const Placement T =
            placed_model(*object.model, start.objects[static_cast<std::size_t>(caster)]);
        footprint.extend(frame.to_plane(T * corner).head<2>());
      }
      const double own = 0.5 * footprint.diagonal().norm();
      if (widest == nullptr || own > radius) {
        widest = &object;
        radius = own;
      }
    }
    if (widest == nullptr || magnification <= half_width / (2.0 * radius)) continue;
    const double fits = half_width / (2.0 * radius);
    advise(fmt::format(
        "{}: {}: where its umbra vanishes the penumbra of \"{}\" is {:.2g} m wide, and the plane "
        "\"{}\" {:.2g} m; {}",
        name_, pointer, shortened(widest->name), 4.0 * magnification * radius,
        shortened(plane.name), 2.0 * half_width,
        fits > 1.0
            ? fmt::format("give a magnification of {:.2f} or less (a light_ratio of {:.1f} or "
                          "more)",
                          fits, fits / (fits - 1.0))
            : "lower the height at which it vanishes, or take a smaller object"));
  }
}

// What comes above the light's reach casts nothing, and above the workspace that the light was
// chosen for has no umbra: told here, once, as no picture of it does.
void SceneReader::advise_on_height(const ShadowNode& node, const std::string& pointer,
                                   bool by_workspace) {
  if (node.technique != ShadowTechnique::layered && node.technique != ShadowTechnique::field)
    return;
  const double reach = layer_height_range(node.layered, ShadowLayer::penumbra).high;
  for (const int index : node.planes) {
    const ScenePlane& plane = scene_.planes[static_cast<std::size_t>(index)];
    // A wall has most of the scene far in front of it, and a plane of other tags moves.
    const bool is_floor = std::abs(plane.normal.z()) > 0.5 && plane.tag_group == kTableGroup;
    if (!is_floor) continue;
    const std::vector<double> tops = highest_points(scene_, plane.normal, plane.point);
    for (const int caster : node.casters) {
      const SceneObject& object = scene_.objects[static_cast<std::size_t>(caster)];
      if (object.tag_group != kTableGroup) continue;  // goes where its tags go
      const double top = tops[static_cast<std::size_t>(caster)];
      if (top > reach) {
        advise(fmt::format(
            "{}: {}: \"{}\" comes to {:.4g} m above \"{}\"; what is above {:.4g} m casts nothing; "
            "raise the light",
            name_, pointer, shortened(object.name), top, shortened(plane.name), reach));
      } else if (by_workspace && top > node.layered.umbra_height * (1.0 + 1e-6)) {
        advise(fmt::format(
            "{}: {}: \"{}\" comes to {:.4g} m above \"{}\", beyond the workspace_height of {:.4g} "
            "m, and has no umbra there; give the highest place that objects come to",
            name_, pointer, shortened(object.name), top, shortened(plane.name),
            node.layered.umbra_height));
      }
    }
  }
}

// Each light's projected shadows on a plane take a bit of the stencil.
void SceneReader::advise_on_lights() {
  std::map<int, std::set<int>> lights_on;
  for (const ShadowNode& node : scene_.shadows) {
    if (node.technique != ShadowTechnique::hard) continue;
    for (const int plane : node.planes) {
      lights_on[plane].insert(node.lights.begin(), node.lights.end());
    }
  }
  for (const auto& [plane, lights] : lights_on) {
    if (lights.size() <= kMaxHardLights) continue;
    scene_.warnings.push_back(fmt::format(
        "{}: /shadows: {} lights throw projected shadows onto \"{}\", which shows those of {}; the "
        "others' are left out: name fewer of them, or take the technique \"volume\"",
        name_, lights.size(), shortened(scene_.planes[static_cast<std::size_t>(plane)].name),
        kMaxHardLights));
  }
}

Result<void> SceneReader::read_shadow(const json& from, const std::string& pointer) {
  ShadowNode node;
  node.name = from.at("name").get<std::string>();
  if (Result<void> checked = check_new_name(node.name, scene_.shadows, pointer); !checked) {
    return checked;
  }
  const auto technique = shadow_technique_from_string(from.at("technique").get<std::string>());
  if (!technique) return fail_at(pointer + "/technique", "is not a technique of this program");
  node.technique = *technique;
  if (const auto given = from.find("kernels"); given != from.end()) {
    const auto kernels = kernel_source_from_string(given->get<std::string>());
    if (!kernels) return fail_at(pointer + "/kernels", "are not kernels of this program");
    node.kernels = *kernels;
  }
  if (const auto given = from.find("light_mode"); given != from.end()) {
    const auto mode = light_mode_from_string(given->get<std::string>());
    if (!mode) return fail_at(pointer + "/light_mode", "is not a mode of this program");
    if (*mode == LightMode::fixed && node.kernels == KernelSource::centroid) {
      return fail_at(pointer + "/light_mode",
                     "is \"fixed\", which needs kernels with a thickness; cocl has none");
    }
    node.light_mode = *mode;
  }
  if (const auto names = from.find("casters"); names != from.end()) {
    PENUMBRA_TRY(std::vector<int> casters,
                 indices_of(*names, scene_.objects, pointer + "/casters", "object"));
    // An object says last whether it casts.
    for (const int caster : casters) {
      if (scene_.objects[static_cast<std::size_t>(caster)].casts_shadow) {
        node.casters.push_back(caster);
      }
    }
  } else {
    for (std::size_t i = 0; i < scene_.objects.size(); ++i) {
      if (scene_.objects[i].casts_shadow) node.casters.push_back(static_cast<int>(i));
    }
  }
  if (const auto names = from.find("planes"); names != from.end()) {
    PENUMBRA_TRY(std::vector<int> planes,
                 indices_of(*names, scene_.planes, pointer + "/planes", "plane"));
    node.planes = std::move(planes);
  } else {
    node.planes = {0};
  }
  if (const auto names = from.find("walls"); names != from.end()) {
    PENUMBRA_TRY(std::vector<int> walls,
                 indices_of(*names, scene_.planes, pointer + "/walls", "plane"));
    node.walls = std::move(walls);
    for (const int plane : node.planes) std::erase(node.walls, plane);
  } else {
    unwalled_nodes_.push_back(scene_.shadows.size());
  }
  if (const auto names = from.find("lights"); names != from.end()) {
    PENUMBRA_TRY(std::vector<int> lights,
                 indices_of(*names, scene_.lights, pointer + "/lights", "light"));
    node.lights = std::move(lights);
  }
  node.light_rays = from.value("light_rays", false);
  if (const auto layered = from.find("layered"); layered != from.end()) {
    PENUMBRA_TRY(LayeredConstants constants, read_layered(*layered, pointer + "/layered"));
    node.layered = constants;
    if (std::isfinite(node.layered.light_height) && node.layered.light_ratio <= 1.0) {
      scene_.warnings.push_back(
          fmt::format("{}: {}/layered: with a light_ratio of 1 or less the umbra never vanishes; "
                      "give more than 1",
                      name_, pointer));
    }
  }
  advise_on_size(node, pointer);
  const auto layered = from.find("layered");
  advise_on_height(node, pointer, layered != from.end() && layered->contains("workspace_height"));
  if (const auto left = from.find("light_left"); left != from.end()) {
    LightFractions& fractions = node.fractions;
    fractions.umbra = left->value("umbra", fractions.umbra);
    fractions.middle = left->value("middle", fractions.middle);
    fractions.penumbra = left->value("penumbra", fractions.penumbra);
    if (!(fractions.umbra <= fractions.middle && fractions.middle <= fractions.penumbra)) {
      scene_.warnings.push_back(
          fmt::format("{}: {}/light_left: the umbra should be darkest and the penumbra lightest",
                      name_, pointer));
    }
  }
  scene_.shadows.push_back(std::move(node));
  return {};
}

Result<Scene> SceneReader::read(const json& root) {
  scene_.file = name_;
  scene_.name = root.value("name", file_.stem().string());
  if (const auto ambient = root.find("ambient"); ambient != root.end()) {
    scene_.ambient = vector_of(*ambient);
  }
  const auto each = [&root](const char* key, const auto& read) -> Result<void> {
    const auto list = root.find(key);
    for (std::size_t i = 0; list != root.end() && i < list->size(); ++i) {
      Result<void> done = read((*list)[i], fmt::format("/{}/{}", key, i));
      if (!done) return done;
    }
    return {};
  };
  Result<void> done = each("objects", [this](const json& from, const std::string& pointer) {
    return read_object(from, pointer, false);
  });
  if (done) {
    done = each("phantoms", [this](const json& from, const std::string& pointer) {
      return read_object(from, pointer, true);
    });
  }
  if (done) {
    done = each("planes", [this](const json& from, const std::string& pointer) {
      return read_plane(from, pointer);
    });
  }
  if (done && scene_.planes.empty()) {
    ScenePlane table;
    table.name = "table";
    scene_.planes.push_back(table);
  }
  if (done) {
    done = each("lights", [this](const json& from, const std::string& pointer) {
      return read_light(from, pointer);
    });
  }
  if (done) {
    done = each("shadows", [this](const json& from, const std::string& pointer) {
      return read_shadow(from, pointer);
    });
  }
  if (!done) return tl::unexpected(done.error());
  if (!scene_.objects.empty() && !root.contains("shadows")) {
    scene_.warnings.push_back(
        fmt::format("{}: has no shadow node, so nothing casts a shadow; add \"shadows\": "
                    "[{{\"name\": \"shadow\", \"technique\": \"layered\"}}], or [] to have none",
                    name_));
  }
  advise_on_lights();
  for (const std::size_t node : unwalled_nodes_) add_default_walls(scene_, scene_.shadows[node]);
  return std::move(scene_);
}
}  // namespace

Result<Scene> load_scene(const std::filesystem::path& file) {
  PENUMBRA_TRY(const json root, read_scene_json(file));
  try {
    return SceneReader(file).read(root);
  } catch (const std::exception& error) {
    return fail("{}: can't be read: {}", file.string(), error.what());
  }
}

}  // namespace penumbra
