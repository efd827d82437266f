#include "core/camera/focus_file.hpp"

#include <exception>

#include "core/text/yaml_fields.hpp"

namespace penumbra {

std::optional<double> load_focus_position(const std::filesystem::path& camera_file) {
  try {
    const auto root = load_yaml_map(camera_file);
    if (!root) return std::nullopt;  // load_camera() says of which kind the file is
    const YamlFields fields(*root, camera_file.string());
    if (!fields.has("focus_position")) return std::nullopt;
    const auto position = fields.number("focus_position", "");
    return position ? std::optional(*position) : std::nullopt;
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

}  // namespace penumbra
