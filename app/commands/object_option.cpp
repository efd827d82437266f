// The option --object.
#include <algorithm>
#include <array>
#include <cstddef>

#include "app/commands/options.hpp"
#include "core/text/text.hpp"
#include "render/model/model_size.hpp"

namespace penumbra {
namespace {

// Returns where the file's name ends: at a comma after a model's extension, or at the first comma.
std::size_t end_of_file_name(std::string_view text) {
  for (std::size_t end = 0; end < text.size();) {
    end = std::min(text.find(',', end + 1), text.size());
    const std::string extension = lower_extension(std::filesystem::path(text.substr(0, end)));
    if (extension == ".glb" || extension == ".gltf" || extension == ".obj") return end;
  }
  return std::min(text.find(','), text.size());
}

// A number as the value of a key of --object.
struct ObjectNumber {
  std::string_view key;
  std::optional<double> ObjectRequest::*field;
  double min_value, max_value;
  std::string_view what;
};
constexpr std::array kObjectNumbers = {
    ObjectNumber{"height", &ObjectRequest::height_m, 0.001, 10.0, "metres"},
    ObjectNumber{"scale", &ObjectRequest::scale, 1e-6, 1e6, "a factor"},
    ObjectNumber{"x", &ObjectRequest::x_m, -100.0, 100.0, "metres"},
    ObjectNumber{"y", &ObjectRequest::y_m, -100.0, 100.0, "metres"},
    ObjectNumber{"z", &ObjectRequest::z_m, -100.0, 100.0, "metres"},
};
constexpr std::string_view kObjectKeys = "height, scale, unit, x, y, z, up, animation";

// Sets what "key=value" says about an object.
void set_object_key(const std::string& option, std::string_view setting, ObjectRequest& object) {
  const std::size_t equals = setting.find('=');
  const std::string_view key = trim(setting.substr(0, equals));
  const std::string_view value =
      equals == std::string_view::npos ? "" : trim(setting.substr(equals + 1));
  if (key == "unit") {
    const LengthUnit* unit = length_unit_from_string(value);
    if (unit == nullptr) usage_error(option, "unit={}: is none of mm, cm, m and in", value);
    if (object.unit_m) usage_error(option, "unit: is given twice; give it once");
    object.unit_m = unit->length_m;
    return;
  }
  if (key == "up") {
    const auto up = value_named(kUpAxisNames, value);
    if (!up) usage_error(option, "up={}: is neither y nor z", value);
    if (object.up != UpAxis::by_format) usage_error(option, "up: is given twice; give it once");
    object.up = *up;
    return;
  }
  if (key == "animation") {
    if (value.empty()) usage_error(option, "animation: give a name, an index or all");
    if (!object.animation.empty()) usage_error(option, "animation: is given twice; give it once");
    object.animation = value;
    return;
  }
  const auto number = std::ranges::find(kObjectNumbers, key, &ObjectNumber::key);
  if (number == kObjectNumbers.end()) {
    usage_error(option, "{}: no such key; known: {}", key, kObjectKeys);
  }
  const auto parsed = parse_number(value);
  if (!parsed || !(*parsed >= number->min_value && *parsed <= number->max_value)) {
    usage_error(option, "{}={}: give {} from {:g} to {:g}", key, value, number->what,
                number->min_value, number->max_value);
  }
  std::optional<double>& field = object.*(number->field);
  if (field) usage_error(option, "{}: is given twice; give it once", key);
  field = *parsed;
}

}  // namespace

ObjectRequest object_from(const std::string& option, const std::string& text) {
  const std::size_t end = end_of_file_name(text);
  ObjectRequest object;
  object.file = text.substr(0, end);
  if (object.file.empty()) usage_error(option, "{}: name a model file first", text);
  if (end < text.size()) {
    for (const std::string_view setting : split(std::string_view(text).substr(end + 1), ','))
      set_object_key(option, setting, object);
  }
  if (object.height_m && (object.scale || object.unit_m)) {
    usage_error(option, "height: already gives the size; leave out {}",
                object.scale ? "scale" : "unit");
  }
  return object;
}

void add_object_option(CLI::App& command, std::vector<ObjectRequest>& objects) {
  start_group(command, "Objects");
  const auto add = [&objects](const std::vector<std::string>& texts) {
    objects.clear();
    for (const std::string& text : texts) objects.push_back(object_from("--object", text));
  };
  command
      .add_option_function<std::vector<std::string>>(
          "--object", add, fmt::format("Put a model on the table; keys: {}", kObjectKeys))
      ->type_name("FILE[,KEY=VALUE...]")
      ->allow_extra_args(false);
}

}  // namespace penumbra
