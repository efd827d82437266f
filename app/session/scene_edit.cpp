#include "app/session/scene_edit.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <system_error>

#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kMaxLineBytes = 1U << 20U;
constexpr std::string_view kMoved = "object_moved";
constexpr std::string_view kRotated = "object_rotated";
constexpr std::string_view kStyled = "shadow_changed";
constexpr std::string_view kAdded = "object_added";
constexpr std::string_view kReset = "object_reset";
constexpr std::string_view kRemoved = "object_removed";
constexpr std::string_view kRestored = "object_restored";
constexpr std::string_view kViewed = "view_changed";
constexpr std::string_view kLit = "video_light";
constexpr double kMaxLight = 1e6;  // multiples of full white
constexpr double kLargestPlace_m = 1e6;
constexpr double kMaxQuaternionError = 1e-3;

bool usable(const Placement& placement) {
  return placement.position.allFinite() &&
         placement.position.cwiseAbs().maxCoeff() < kLargestPlace_m &&
         placement.rotation.coeffs().allFinite() &&
         std::abs(placement.rotation.norm() - 1.0) < kMaxQuaternionError &&
         std::isfinite(placement.scale) && placement.scale > 0.0 &&
         placement.scale < kLargestPlace_m;
}

bool usable(const ShadowStyle& style) {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0.0; };
  const auto fraction = [](double value) { return value >= 0.0 && value <= 1.0; };
  const LayeredConstants& c = style.layered;
  return c.light_height > 0.0 && c.light_ratio > 0.0 && positive(c.umbra_height) &&
         std::isfinite(c.magnification_cap) && c.magnification_cap > 1.0 &&
         fraction(style.fractions.umbra) && fraction(style.fractions.middle) &&
         fraction(style.fractions.penumbra);
}

bool usable(const VideoLight& light) {
  const auto good = [](const Eigen::Vector3d& v) {
    return v.allFinite() && v.minCoeff() > 0.0 && v.maxCoeff() < kMaxLight;
  };
  return good(light.on_table) && good(light.around);
}

// JSON has no infinity.
Json number(double value) {
  return std::isinf(value) ? Json("inf") : Json(value);
}

// Returns NaN, which usable() rejects, if the value is missing or not a number.
double number_in(const Json& json, const char* key) {
  const auto found = json.find(key);
  if (found == json.end()) return std::numeric_limits<double>::quiet_NaN();
  if (found->is_number()) return found->get<double>();
  if (found->is_string() && *found == "inf") return std::numeric_limits<double>::infinity();
  return std::numeric_limits<double>::quiet_NaN();
}

template <int N>
Eigen::Matrix<double, N, 1> numbers_in(const Json& json, const char* key) {
  Eigen::Matrix<double, N, 1> values;
  values.setConstant(std::numeric_limits<double>::quiet_NaN());
  const auto found = json.find(key);
  if (found == json.end() || !found->is_array() || found->size() != static_cast<std::size_t>(N)) {
    return values;
  }
  for (int i = 0; i < N; ++i) {
    const Json& value = (*found)[static_cast<std::size_t>(i)];
    if (value.is_number()) values[i] = value.get<double>();
  }
  return values;
}

std::string text_in(const Json& json, const char* key) {
  const auto found = json.find(key);
  return found != json.end() && found->is_string() ? found->get<std::string>() : std::string();
}

// Reads the nanoseconds exactly, without a conversion to double.
std::optional<std::int64_t> timestamp_of(std::string_view line) {
  constexpr std::string_view kKey = "\"timestamp_s\":";
  const std::size_t at = line.find(kKey);
  if (at == std::string_view::npos) return std::nullopt;
  const std::string_view rest = line.substr(at + kKey.size());
  return parse_seconds_as_ns(trim(rest.substr(0, rest.find_first_of(",}"))));
}

// Returns the line with the time as a decimal number with nanoseconds.
std::string line_of(std::int64_t timestamp_ns, const Json& json) {
  const std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  return "{\"timestamp_s\":" + format_ns_as_seconds(timestamp_ns) + "," + text.substr(1);
}

std::optional<VideoLight> light_in(const Json& json) {
  const VideoLight light = {numbers_in<3>(json, "on_table"), numbers_in<3>(json, "around")};
  return usable(light) ? std::optional(light) : std::nullopt;
}

std::optional<SceneEdit> edit_in(const Json& json, std::string_view event) {
  if (event == kStyled) {
    ShadowStyled styled;
    styled.node = text_in(json, "node");
    const auto technique = value_named(kShadowTechniqueNames, text_in(json, "technique"));
    const auto kernels = value_named(kKernelSourceNames, text_in(json, "kernels"));
    if (!technique || !kernels) return std::nullopt;
    styled.style.technique = *technique;
    styled.style.kernels = *kernels;
    styled.style.layered = {number_in(json, "light_height"), number_in(json, "light_ratio"),
                            number_in(json, "umbra_height"), number_in(json, "magnification_cap")};
    styled.style.fractions = {number_in(json, "umbra"), number_in(json, "middle"),
                              number_in(json, "penumbra")};
    // Optional, because earlier versions did not write it.
    const auto rays = json.find("light_rays");
    styled.style.light_rays = rays != json.end() && rays->is_boolean() && rays->get<bool>();
    if (!usable(styled.style)) return std::nullopt;
    return styled;
  }
  if (event == kViewed) {
    const auto mode = value_named(kTranslucencyNames, text_in(json, "translucency"));
    const auto walls = json.find("walls"), smooth = json.find("smooth");
    const auto is_choice = [&](const auto& key) { return key != json.end() && key->is_boolean(); };
    if (!mode || !is_choice(walls) || !is_choice(smooth)) return std::nullopt;
    return ViewChanged{*mode, walls->get<bool>(), smooth->get<bool>()};
  }
  const std::string object = text_in(json, "object");
  if (event == kReset) return ObjectReset{object};
  if (event == kRemoved || event == kRestored) return ObjectRemoved{object, event == kRemoved};
  Placement placement;
  placement.position = numbers_in<3>(json, "position");
  placement.rotation.coeffs() = numbers_in<4>(json, "quaternion_xyzw");
  placement.scale = number_in(json, "scale");
  if (!usable(placement)) return std::nullopt;
  if (event == kAdded) {
    ObjectAdded added{object, text_in(json, "model"), placement, nullptr};
    added.up = value_named(kUpAxisNames, text_in(json, "up")).value_or(UpAxis::by_format);
    added.playback.animation = text_in(json, "animation");
    return added;
  }
  return ObjectPlaced{object, placement, event == kRotated};
}

bool is_edit(std::string_view event) {
  constexpr std::array kEdits = {kMoved, kRotated, kStyled,   kAdded,
                                 kReset, kRemoved, kRestored, kViewed};
  return std::ranges::find(kEdits, event) != kEdits.end();
}

// Adds the event of a line; ignores unknown events. `name`: file and line number, for errors.
Result<void> add_event(std::string_view line, const std::string& name, SceneEvents& events) {
  const Json json = Json::parse(line, nullptr, false);
  if (!json.is_object()) return fail("{}: is not a JSON object; remove the line", name);
  const std::string event = text_in(json, "event");
  const auto timestamp_ns = timestamp_of(line);
  if (event == kSceneStartEvent) {
    events.scene_start_ns = timestamp_ns;
    events.scene = text_in(json, "detail");
  }
  if (is_edit(event)) {
    if (!timestamp_ns)
      return fail("{}: timestamp_s is not a time in seconds; remove the line", name);
    const auto edit = edit_in(json, event);
    if (!edit) return fail("{}: {}: a number is missing or out of range", name, event);
    events.edits.push_back({*timestamp_ns, *edit});
  }
  if (event == kLit) {
    const auto light = light_in(json);
    if (!timestamp_ns || !light) {
      return fail("{}: {}: a number is missing or out of range; remove the line", name, event);
    }
    events.lights.push_back({*timestamp_ns, *light});
  }
  return {};
}

SceneObject* object_named(Scene& scene, const std::string& name) {
  const auto object = std::ranges::find(scene.objects, name, &SceneObject::name);
  return object == scene.objects.end() ? nullptr : &*object;
}

void place(SceneObject& object, const Placement& placement) {
  object.placement = placement;
  object.animation = Animation();
  object.tag_group = kTableGroup;  // keeps the object at its place on the table
}

bool apply_to(Scene& scene, const ObjectPlaced& edit, Scene* /*start*/) {
  SceneObject* object = object_named(scene, edit.object);
  if (object == nullptr || !usable(edit.placement)) return false;
  place(*object, edit.placement);
  return true;
}

bool apply_to(Scene& scene, const ShadowStyled& edit, Scene* /*start*/) {
  const auto node = std::ranges::find(scene.shadows, edit.node, &ShadowNode::name);
  if (node == scene.shadows.end() || !usable(edit.style)) return false;
  static_cast<ShadowStyle&>(*node) = edit.style;
  return true;
}

bool apply_to(Scene& scene, const ObjectAdded& edit, Scene* start) {
  if (!usable(edit.placement)) return false;
  if (SceneObject* known = object_named(scene, edit.object)) {
    place(*known, edit.placement);
    known->removed = false;
    if (known->added && start != nullptr) {
      place(*object_named(*start, edit.object), edit.placement);
    }
    return true;
  }
  if (!edit.model) return false;
  SceneObject object;
  object.name = edit.object;
  object.model = edit.model;
  object.model_file = edit.model_file;
  object.up = edit.up;
  object.playback = edit.playback;
  object.placement = edit.placement;
  if (start == nullptr) {
    add_object(scene, std::move(object));
    return true;
  }
  // The casters' places at the start determine the walls.
  add_object(*start, std::move(object));
  scene.objects.push_back(start->objects.back());
  scene.planes = start->planes;
  for (std::size_t i = 0; i < scene.shadows.size(); ++i) {
    scene.shadows[i].casters = start->shadows[i].casters;
    scene.shadows[i].walls = start->shadows[i].walls;
  }
  return true;
}

bool apply_to(Scene& /*scene*/, const ViewChanged& /*edit*/, Scene* /*start*/) {
  return true;
}

bool apply_to(Scene& scene, const ObjectReset& edit, Scene* start) {
  SceneObject* object = object_named(scene, edit.object);
  const SceneObject* before = start == nullptr ? nullptr : object_named(*start, edit.object);
  if (object == nullptr || before == nullptr) return false;
  object->placement = before->placement;
  object->animation = before->animation;
  object->tag_group = before->tag_group;
  return true;
}

bool apply_to(Scene& scene, const ObjectRemoved& edit, Scene* /*start*/) {
  SceneObject* object = object_named(scene, edit.object);
  if (object == nullptr || !object->added) return false;
  object->removed = edit.removed;
  return true;
}

void write_placement(Json& json, const Placement& placement) {
  const Eigen::Vector3d& p = placement.position;
  const Eigen::Quaterniond& q = placement.rotation;
  json["position"] = {p.x(), p.y(), p.z()};
  json["quaternion_xyzw"] = {q.x(), q.y(), q.z(), q.w()};
  json["scale"] = placement.scale;
}

Json json_of(const ObjectPlaced& placed) {
  Json json;
  json["event"] = placed.turned ? kRotated : kMoved;
  json["object"] = placed.object;
  write_placement(json, placed.placement);
  return json;
}

Json json_of(const ShadowStyled& styled) {
  const LayeredConstants& c = styled.style.layered;
  Json json;
  json["event"] = kStyled;
  json["node"] = styled.node;
  json["technique"] = to_string(styled.style.technique);
  json["kernels"] = to_string(styled.style.kernels);
  json["light_height"] = number(c.light_height);
  json["light_ratio"] = number(c.light_ratio);
  json["umbra_height"] = number(c.umbra_height);
  json["magnification_cap"] = number(c.magnification_cap);
  json["umbra"] = styled.style.fractions.umbra;
  json["middle"] = styled.style.fractions.middle;
  json["penumbra"] = styled.style.fractions.penumbra;
  if (styled.style.light_rays) json["light_rays"] = true;
  return json;
}

Json json_of(const ObjectAdded& added) {
  Json json;
  json["event"] = kAdded;
  json["object"] = added.object;
  json["model"] = added.model_file;
  if (added.up != UpAxis::by_format) json["up"] = name_of(kUpAxisNames, added.up);
  if (!added.playback.animation.empty()) json["animation"] = added.playback.animation;
  write_placement(json, added.placement);
  return json;
}

Json json_of(const ObjectReset& reset) {
  return {{"event", kReset}, {"object", reset.object}};
}

Json json_of(const ViewChanged& view) {
  return {{"event", kViewed},
          {"translucency", name_of(kTranslucencyNames, view.translucency)},
          {"walls", view.walls},
          {"smooth", view.smooth}};
}

Json json_of(const ObjectRemoved& removed) {
  return {{"event", removed.removed ? kRemoved : kRestored}, {"object", removed.object}};
}

}  // namespace

bool adds_objects(const SceneEvents& events) {
  return std::ranges::any_of(events.edits, [](const SceneEvent& event) {
    return std::holds_alternative<ObjectAdded>(event.edit);
  });
}

bool apply(Scene& scene, const SceneEdit& edit, Scene* start) {
  return std::visit([&](const auto& of_kind) { return apply_to(scene, of_kind, start); }, edit);
}

std::string event_line(const SceneEvent& event) {
  return line_of(event.timestamp_ns,
                 std::visit([](const auto& edit) { return json_of(edit); }, event.edit));
}

std::string light_line(const LitFrame& lit) {
  const Eigen::Vector3d& table = lit.light.on_table;
  const Eigen::Vector3d& around = lit.light.around;
  Json json;
  json["event"] = kLit;
  json["on_table"] = {table.x(), table.y(), table.z()};
  json["around"] = {around.x(), around.y(), around.z()};
  return line_of(lit.timestamp_ns, json);
}

const VideoLight* light_at(const std::vector<LitFrame>& lights, std::int64_t timestamp_ns) {
  if (lights.empty()) return nullptr;
  const auto later = std::ranges::upper_bound(lights, timestamp_ns, {}, &LitFrame::timestamp_ns);
  return later == lights.begin() ? &later->light : &std::prev(later)->light;
}

Result<SceneEvents> load_scene_events(const std::filesystem::path& file) {
  SceneEvents events;
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored)) return events;
  std::ifstream stream(file, std::ios::binary);
  if (!stream || std::filesystem::is_directory(file, ignored)) {
    return fail("{}: cannot be read; check its permissions", file.string());
  }
  // Reads line by line, because a long session has many events.
  std::vector<char> buffer(kMaxLineBytes);
  for (std::size_t number = 1;; ++number) {
    stream.getline(buffer.data(), static_cast<std::streamsize>(buffer.size()));
    const bool is_last = stream.eof();  // has no line break, so it may be incomplete
    if (!is_last && !stream) {
      return fail("{}: line {}: is longer than {} bytes; remove the line", file.string(), number,
                  kMaxLineBytes);
    }
    const auto read = static_cast<std::size_t>(stream.gcount());
    std::string_view line(buffer.data(), is_last || read == 0 ? read : read - 1);
    if (number == 1) {
      PENUMBRA_TRY(line, without_byte_order_mark(line, file.string()));
    }
    line = trim(line);
    if (!line.empty()) {
      auto added = add_event(line, fmt::format("{}: line {}", file.string(), number), events);
      if (!added && !is_last) return tl::unexpected(added.error());
    }
    if (is_last) break;
  }
  std::ranges::stable_sort(events.edits, {}, &SceneEvent::timestamp_ns);
  std::ranges::stable_sort(events.lights, {}, &LitFrame::timestamp_ns);
  return events;
}

}  // namespace penumbra
