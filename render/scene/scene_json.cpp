// valijson validates a scene against the published schema; find_violation() explains errors.
#include "render/scene/scene_json.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <regex>
#include <set>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validation_results.hpp>
#include <valijson/validator.hpp>

#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

using nlohmann::json;

constexpr std::size_t kMaxSceneBytes = std::size_t{64} << 20U;

std::string shown(const json& value) {
  if (value.is_object()) return "an object";
  if (value.is_array()) {
    return value.empty() ? "an empty list" : fmt::format("a list of {}", value.size());
  }
  return shortened(value.dump(-1, ' ', true, json::error_handler_t::replace));
}

// Callback for json::parse that finds duplicate keys; json::parse keeps the last value.
class DuplicateKeys {
 public:
  bool operator()(json::parse_event_t event, const json& parsed) {
    using Event = json::parse_event_t;
    const bool begins = event == Event::object_start || event == Event::array_start;
    if ((begins || event == Event::value) && !open_.empty() && open_.back().is_list) {
      ++open_.back().entries;
    }
    if (begins) {
      open_.push_back({event == Event::array_start, 0, "", {}});
    } else if (event == Event::object_end || event == Event::array_end) {
      open_.pop_back();
    } else if (event == Event::key) {
      open_.back().key = parsed.get<std::string>();
      if (!open_.back().keys.insert(open_.back().key).second && !first_) first_ = pointer();
    }
    return true;
  }
  [[nodiscard]] const std::optional<std::string>& first() const { return first_; }

 private:
  struct Level {
    bool is_list = false;
    std::size_t entries = 0;  // number in the list, including the current one
    std::string key;          // current key of an object
    std::set<std::string> keys;
  };
  [[nodiscard]] std::string pointer() const {
    std::string place;
    for (const Level& level : open_) {
      place += "/" + (level.is_list ? std::to_string(level.entries - 1) : shortened(level.key));
    }
    return place;
  }

  std::vector<Level> open_;
  std::optional<std::string> first_;
};

// Counts the characters of UTF-8 text, without continuation bytes.
std::size_t character_count(const std::string& text) {
  return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) {
    return (static_cast<unsigned char>(c) & 0xC0U) != 0x80U;
  }));
}

const json& resolved(const json& root, const json& schema) {
  const auto reference = schema.find("$ref");
  if (reference == schema.end()) return schema;
  return root.at(json::json_pointer(reference->get<std::string>().substr(1)));
}

bool has_type(const json& value, const std::string& type) {
  if (type == "object") return value.is_object();
  if (type == "array") return value.is_array();
  if (type == "string") return value.is_string();
  if (type == "boolean") return value.is_boolean();
  if (type == "integer") return value.is_number_integer();
  return value.is_number();
}

struct Violation {
  std::string pointer;
  std::string cause;
};

// Returns the first violation of the schema. Walks value and schema in parallel and checks the
// keywords that the schema uses; a unit test lists them. `expected` is a custom keyword with the
// text for messages; `description` is for editors.
std::optional<Violation> find_violation(const json& root, const json& reference, const json& value,
                                        const std::string& pointer) {
  const json& schema = resolved(root, reference);
  const std::string wanted = "give " + schema.value("expected", std::string("a valid value"));
  const auto wrong = [&]() {
    return Violation{pointer, fmt::format("is {}; {}", shown(value), wanted)};
  };
  if (const auto type = schema.find("type"); type != schema.end()) {
    const json types = type->is_array() ? *type : json::array({*type});
    const bool good = std::ranges::any_of(
        types, [&value](const json& name) { return has_type(value, name.get<std::string>()); });
    if (!good) return wrong();
  }
  if (const auto choices = schema.find("enum"); choices != schema.end()) {
    if (std::find(choices->begin(), choices->end(), value) == choices->end()) {
      const auto names = choices->get<std::vector<std::string>>();
      return Violation{pointer,
                       fmt::format("is \"{}\"; give one of {}", shortened(value.get<std::string>()),
                                   fmt::join(names, ", "))};
    }
  }
  if (value.is_number()) {
    const double x = value.get<double>();
    if (!std::isfinite(x) || x < schema.value("minimum", x) || x > schema.value("maximum", x) ||
        (schema.contains("exclusiveMinimum") && x <= schema["exclusiveMinimum"].get<double>())) {
      return wrong();
    }
  }
  if (value.is_string()) {
    const std::string& text = value.get_ref<const std::string&>();
    const std::size_t characters = character_count(text);
    if (characters < schema.value("minLength", std::size_t{0}) ||
        characters > schema.value("maxLength", std::numeric_limits<std::size_t>::max())) {
      return wrong();
    }
    const auto pattern = schema.find("pattern");
    if (pattern != schema.end() &&
        !std::regex_search(text, std::regex(pattern->get<std::string>(), std::regex::ECMAScript))) {
      return wrong();
    }
  }
  if (value.is_array()) {
    if (value.size() < schema.value("minItems", std::size_t{0}) ||
        value.size() > schema.value("maxItems", std::numeric_limits<std::size_t>::max())) {
      return wrong();
    }
    const auto items = schema.find("items");
    for (std::size_t i = 0; items != schema.end() && i < value.size(); ++i) {
      auto found = find_violation(root, *items, value[i], fmt::format("{}/{}", pointer, i));
      if (found) return found;
    }
  }
  if (value.is_object()) {
    const json& properties = schema.at("properties");
    std::vector<std::string> known;
    for (const auto& [key, unused] : properties.items()) known.push_back(key);
    for (const auto& [key, member] : value.items()) {
      const std::string place = pointer + "/" + shortened(key);
      const auto property = properties.find(key);
      if (property == properties.end()) {
        const bool is_unit = edit_distance(in_lower_case(key.substr(0, 64)), "unit") <= 1 &&
                             properties.contains("scale");
        return Violation{place, "is not a known key; " +
                                    (is_unit ? "for a model in millimetres give \"scale\": 0.001"
                                             : suggestion(key, known))};
      }
      auto found = find_violation(root, *property, member, place);
      if (found) return found;
    }
    for (const json& key : schema.value("required", json::array())) {
      if (!value.contains(key.get<std::string>())) {
        return Violation{pointer, fmt::format("has no \"{}\"; add it", key.get<std::string>())};
      }
    }
  }
  return std::nullopt;
}

// Returns "parse error at ..." from "[json.exception.parse_error.101] parse error at ...".
std::string without_tag(std::string_view text) {
  const std::size_t tag = text.find("] ");
  return std::string(text.substr(tag == std::string_view::npos ? 0 : tag + 2)).substr(0, 200);
}

}  // namespace

std::string suggestion(std::string_view word, const std::vector<std::string>& known) {
  const std::string_view start = word.substr(0, 64);
  const std::string* nearest = nullptr;
  std::size_t best = std::max<std::size_t>(2, start.size() / 3) + 1;
  for (const std::string& candidate : known) {
    const std::size_t distance = edit_distance(start, candidate);
    if (distance < best) {
      best = distance;
      nearest = &candidate;
    }
  }
  if (nearest != nullptr) return fmt::format("did you mean \"{}\"?", *nearest);
  if (known.empty()) return "there are none";
  std::vector<std::string> shown(known.begin(),
                                 known.begin() + std::min<std::ptrdiff_t>(20, std::ssize(known)));
  for (std::string& name : shown) name = shortened(name);
  return fmt::format("known are {}", fmt::join(shown, ", "));
}

Result<void> check_scene_json(const std::string& name, const json& root) {
  const json schema_document = json::parse(scene_schema());
  valijson::Schema schema;
  valijson::SchemaParser().populateSchema(valijson::adapters::NlohmannJsonAdapter(schema_document),
                                          schema);
  valijson::Validator validator;
  valijson::ValidationResults results;
  if (validator.validate(schema, valijson::adapters::NlohmannJsonAdapter(root), &results)) {
    return {};
  }
  if (const auto found = find_violation(schema_document, schema_document, root, "")) {
    return fail("{}: {}: {}", name, found->pointer.empty() ? "/" : found->pointer, found->cause);
  }
  valijson::ValidationResults::Error error;
  results.popError(error);
  return fail("{}: breaks the schema of scenes: {}", name, error.description);
}

Result<json> read_scene_json(const std::filesystem::path& file, std::string* content) {
  const std::string name = file.string();
  PENUMBRA_TRY(const std::vector<std::uint8_t> bytes, read_file(file, kMaxSceneBytes));
  PENUMBRA_TRY(
      const std::string_view text,
      without_byte_order_mark({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, name));
  try {
    DuplicateKeys duplicates;
    json root = json::parse(text.begin(), text.end(),
                            [&duplicates](int, json::parse_event_t event, json& parsed) {
                              return duplicates(event, parsed);
                            });
    if (duplicates.first()) {
      return fail("{}: {}: is given twice; remove one of them", name, *duplicates.first());
    }
    PENUMBRA_TRY_VOID(check_scene_json(name, root));
    if (content != nullptr) *content = text;
    return root;
  } catch (const json::exception& error) {
    return fail("{}: is not JSON: {}; check commas and brackets there", name,
                without_tag(error.what()));
  } catch (const std::exception& error) {
    return fail("{}: can't be read: {}", name, error.what());
  }
}

}  // namespace penumbra
