// Reads fields of YAML files with errors that name the field, the line and the remedy.
// Include in .cpp files only, because it includes yaml-cpp.
#pragma once

#include <yaml-cpp/yaml.h>

#include <cstddef>
#include <exception>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

inline constexpr std::size_t kMaxYamlBytes = std::size_t{8} << 20U;

// Returns the root of a YAML file, which must be a map. Does not throw.
[[nodiscard]] Result<YAML::Node> load_yaml_map(const std::filesystem::path& file);
// Parses a file's text; `name` is the file's name in errors.
[[nodiscard]] Result<YAML::Node> parse_yaml_map(const std::string& text, const std::string& name);

// Loads a YAML map and returns `read(root)`, a Result. Converts an exception of yaml-cpp in `read`
// to an error that contains `kind`, such as "a tag map".
template <class Read>
auto read_yaml_map(const std::filesystem::path& file, std::string_view kind, const Read& read)
    -> decltype(read(std::declval<const YAML::Node&>())) {
  const Result<YAML::Node> root = load_yaml_map(file);
  if (!root) return tl::unexpected(root.error());
  try {
    return read(*root);
  } catch (const std::exception& error) {
    return fail("{}: is not readable as {} ({}); correct the file", file.string(), kind,
                error.what());
  }
}

// A map in the file. Every message starts with `place`: "tags.yaml: tags[3]".
class YamlFields {
 public:
  YamlFields(YAML::Node map, std::string place) : map_(std::move(map)), place_(std::move(place)) {}

  [[nodiscard]] bool has(const std::string& key) const;
  // Returns whether an optional key is present. Fails if it is absent but a similar key is present
  // (edit distance up to 2, or "size" for "size_m"), because a misspelt key would be ignored.
  [[nodiscard]] Result<bool> has_optional(const std::string& key) const;
  [[nodiscard]] Result<YAML::Node> node(const std::string& key, const char* remedy) const;
  [[nodiscard]] Result<double> number(const std::string& key, const char* remedy) const;
  [[nodiscard]] Result<int> integer(const std::string& key, const char* remedy) const;
  [[nodiscard]] Result<std::string> text(const std::string& key, const char* remedy) const;
  // Returns nullopt if the key is absent; fails as has_optional() does.
  [[nodiscard]] Result<std::optional<double>> optional_number(const std::string& key,
                                                              const char* remedy) const;
  // Returns a list of finite numbers.
  [[nodiscard]] Result<std::vector<double>> numbers(const std::string& key,
                                                    const char* remedy) const;
  // Fails if the list does not have `count` numbers.
  [[nodiscard]] Result<std::vector<double>> numbers(const std::string& key, std::size_t count,
                                                    const char* remedy) const;
  [[nodiscard]] Result<YamlFields> fields(const std::string& key, const char* remedy) const;

  [[nodiscard]] const std::string& place() const { return place_; }
  // Returns "place: key (line n)".
  [[nodiscard]] std::string place_of(const std::string& key) const;

 private:
  const YAML::Node map_;  // const: operator[] never inserts
  std::string place_;
};

}  // namespace penumbra
