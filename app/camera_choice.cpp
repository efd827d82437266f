#include "app/camera_choice.hpp"

#include <utility>

#include "app/logging.hpp"
#include "core/camera/camera_file.hpp"

namespace penumbra {

Result<CameraModel> load_chosen_camera(const std::filesystem::path& file, const std::string& name) {
  Result<LoadedCamera> loaded = load_camera_file(file, name);
  if (!loaded) return tl::unexpected(loaded.error());
  for (const std::string& warning : loaded->warnings) log_warning("{}", warning);
  return std::move(loaded->camera);
}

}  // namespace penumbra
