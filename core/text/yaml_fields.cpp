#include "core/text/yaml_fields.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

// Returns the node's text for a message, truncated to 40 characters.
std::string shown(const YAML::Node& node) {
  if (!node.IsScalar()) return node.IsNull() ? "empty" : "not a single value";
  return fmt::format("'{}'", shortened(node.Scalar(), 40));
}

// Rejects what yaml-cpp accepts: duplicate keys of a map (yaml-cpp uses the first), recursive
// aliases, and aliases that expand to more than kMaxNodes nodes.
class DocumentCheck {
 public:
  [[nodiscard]] std::optional<std::string> problem(const YAML::Node& node, int depth = 0) {
    constexpr int kMaxDepth = 32;
    constexpr int kMaxNodes = 1'000'000;
    if (depth > kMaxDepth || ++nodes_ > kMaxNodes) {
      return fmt::format(
          "line {}: holds itself, or far more than such a file does; write values out in place of "
          "aliases (*name)",
          node.Mark().line + 1);
    }
    if (node.IsMap()) {
      std::set<std::string> keys;
      for (const auto& entry : node) {
        if (entry.first.IsScalar() && !keys.insert(entry.first.Scalar()).second) {
          return fmt::format("line {}: {} is there twice; keep one of them",
                             entry.first.Mark().line + 1, shown(entry.first));
        }
        if (auto found = problem(entry.second, depth + 1)) return found;
      }
    } else if (node.IsSequence()) {
      for (const auto& entry : node) {
        if (auto found = problem(entry, depth + 1)) return found;
      }
    }
    return std::nullopt;
  }

 private:
  int nodes_ = 0;
};

// Blanks the %YAML lines at the start, because OpenCV's "%YAML:1.0" is not valid YAML. Keeps the
// line numbers.
std::string without_version(std::string text) {
  for (std::size_t start = 0; start < text.size();) {
    const std::size_t end = std::min(text.find('\n', start), text.size());
    const std::string_view line = trim(std::string_view(text).substr(start, end - start));
    if (line.starts_with("%YAML")) {
      text.erase(start, end - start);
      ++start;
    } else if (line.empty() || line.starts_with('#')) {
      start = end + 1;
    } else {
      break;
    }
  }
  return text;
}

}  // namespace

Result<YAML::Node> load_yaml_map(const std::filesystem::path& file) {
  PENUMBRA_TRY(const std::string text, read_text_file(file, kMaxYamlBytes));
  return parse_yaml_map(text, file.string());
}

Result<YAML::Node> parse_yaml_map(const std::string& text, const std::string& name) {
  try {
    YAML::Node root = YAML::Load(without_version(text));
    if (!root.IsMap()) {
      return fail("{}: is not a YAML map; it must hold lines of the form `name: value`", name);
    }
    if (const auto problem = DocumentCheck().problem(root)) return fail("{}: {}", name, *problem);
    return root;
  } catch (const YAML::Exception& error) {
    return fail("{}: line {}: is not valid YAML ({}); correct the line", name, error.mark.line + 1,
                error.msg);
  } catch (const std::exception& error) {
    return fail("{}: is not valid YAML ({}); correct the file", name, error.what());
  }
}

bool YamlFields::has(const std::string& key) const {
  return map_[key].IsDefined();
}

Result<bool> YamlFields::has_optional(const std::string& key) const {
  if (has(key)) return true;
  constexpr std::size_t kMaxEdits = 2;
  constexpr std::size_t kMaxLength = 64;
  constexpr std::array<std::string_view, 3> kUnits = {"_m", "_px", "_s"};
  for (const auto& entry : map_) {
    if (!entry.first.IsScalar()) continue;
    const std::string& present = entry.first.Scalar();
    if (present.size() > kMaxLength) continue;
    const bool without_unit = std::ranges::any_of(
        kUnits, [&](std::string_view unit) { return key == present + std::string(unit); });
    if (!without_unit && edit_distance(present, key) > kMaxEdits) continue;
    return fail("{}: is not known; did you mean `{}`?", place_of(present), key);
  }
  return false;
}

std::string YamlFields::place_of(const std::string& key) const {
  const YAML::Node found = map_[key];
  if (!found.IsDefined() || found.Mark().line < 0) return fmt::format("{}: {}", place_, key);
  return fmt::format("{}: {} (line {})", place_, key, found.Mark().line + 1);
}

Result<YAML::Node> YamlFields::node(const std::string& key, const char* remedy) const {
  YAML::Node found = map_[key];
  if (!found.IsDefined()) return fail("{}: {}: is missing; {}", place_, key, remedy);
  return found;
}

Result<double> YamlFields::number(const std::string& key, const char* remedy) const {
  PENUMBRA_TRY(const YAML::Node found, node(key, remedy));
  const std::optional<double> value =
      found.IsScalar() ? parse_number(found.Scalar()) : std::nullopt;
  if (!value || !std::isfinite(*value))
    return fail("{}: {} is not a finite number; {}", place_of(key), shown(found), remedy);
  return *value;
}

Result<std::optional<double>> YamlFields::optional_number(const std::string& key,
                                                          const char* remedy) const {
  PENUMBRA_TRY(const bool present, has_optional(key));
  if (!present) return std::nullopt;
  return number(key, remedy);
}

Result<int> YamlFields::integer(const std::string& key, const char* remedy) const {
  PENUMBRA_TRY(const YAML::Node found, node(key, remedy));
  const std::optional<std::int64_t> value =
      found.IsScalar() ? parse_integer(found.Scalar()) : std::nullopt;
  if (!value || *value < std::numeric_limits<int>::min() ||
      *value > std::numeric_limits<int>::max())
    return fail("{}: {} is not a whole number; {}", place_of(key), shown(found), remedy);
  return static_cast<int>(*value);
}

Result<std::string> YamlFields::text(const std::string& key, const char* remedy) const {
  PENUMBRA_TRY(const YAML::Node found, node(key, remedy));
  if (!found.IsScalar() || found.Scalar().empty())
    return fail("{}: {} is not text; {}", place_of(key), shown(found), remedy);
  return found.Scalar();
}

Result<std::vector<double>> YamlFields::numbers(const std::string& key, const char* remedy) const {
  PENUMBRA_TRY(const YAML::Node found, node(key, remedy));
  if (!found.IsSequence()) return fail("{}: is not a list of numbers; {}", place_of(key), remedy);
  std::vector<double> values;
  for (const YAML::Node& item : found) {
    const std::optional<double> value =
        item.IsScalar() ? parse_number(item.Scalar()) : std::nullopt;
    if (!value || !std::isfinite(*value)) {
      return fail("{}: value {} is {}, not a finite number; {}", place_of(key), values.size() + 1,
                  shown(item), remedy);
    }
    values.push_back(*value);
  }
  return values;
}

Result<std::vector<double>> YamlFields::numbers(const std::string& key, std::size_t count,
                                                const char* remedy) const {
  PENUMBRA_TRY(std::vector<double> values, numbers(key, remedy));
  if (values.size() != count)
    return fail("{}: has {} numbers; {}", place_of(key), values.size(), remedy);
  return values;
}

Result<YamlFields> YamlFields::fields(const std::string& key, const char* remedy) const {
  PENUMBRA_TRY(const YAML::Node found, node(key, remedy));
  if (!found.IsMap()) return fail("{}: is not a map; {}", place_of(key), remedy);
  return YamlFields(found, fmt::format("{}: {}", place_, key));
}

}  // namespace penumbra
