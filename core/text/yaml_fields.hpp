// Reads fields of YAML files with errors that name the field, the line and the remedy.
// For the .cpp files of this folder: it brings yaml-cpp along.
#pragma once

#include <yaml-cpp/yaml.h>

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// The root of a YAML file that is a map. yaml-cpp's exceptions end here.
[[nodiscard]] Result<YAML::Node> load_yaml_map(const std::filesystem::path& file);
// The same of a file's text; `name` is put into errors.
[[nodiscard]] Result<YAML::Node> parse_yaml_map(const std::string& text, const std::string& name);
inline constexpr std::size_t kMaxYamlBytes = std::size_t{8} << 20U;

// One map of the file. `place` stands in front of every message: "tags.yaml: tags[3]".
class YamlFields {
 public:
  YamlFields(YAML::Node map, std::string place) : map_(std::move(map)), place_(std::move(place)) {}

  [[nodiscard]] bool has(const char* key) const;
  // Whether a key that may be left out is there. Fails where it is not, but one that is up to two
  // letters off or without its unit is: what is misspelt would be ignored.
  [[nodiscard]] Result<bool> has_optional(const char* key) const;
  [[nodiscard]] Result<YAML::Node> node(const char* key, const char* remedy) const;
  [[nodiscard]] Result<double> number(const char* key, const char* remedy) const;
  [[nodiscard]] Result<int> integer(const char* key, const char* remedy) const;
  [[nodiscard]] Result<std::string> text(const char* key, const char* remedy) const;
  // A list of finite numbers.
  [[nodiscard]] Result<std::vector<double>> numbers(const char* key, const char* remedy) const;
  [[nodiscard]] Result<YamlFields> fields(const char* key, const char* remedy) const;

  [[nodiscard]] const std::string& place() const { return place_; }
  // "place: key (line n)"
  [[nodiscard]] std::string place_of(const char* key) const;

 private:
  [[nodiscard]] YAML::Node find(const char* key) const;

  YAML::Node map_;
  std::string place_;
};

}  // namespace penumbra
