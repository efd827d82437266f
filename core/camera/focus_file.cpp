#include "core/camera/focus_file.hpp"

#include "core/text/yaml_fields.hpp"

namespace penumbra {

std::optional<double> load_focus_position(const std::filesystem::path& camera_file) {
  const auto position =
      read_yaml_map(camera_file, "a camera file", [&](const YAML::Node& root) -> Result<double> {
        return YamlFields(root, camera_file.string()).number("focus_position", "");
      });
  return position ? std::optional(*position) : std::nullopt;
}

}  // namespace penumbra
