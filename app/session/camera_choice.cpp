#include "app/session/camera_choice.hpp"

#include <utility>

#include "app/logging.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"

namespace penumbra {

Result<CameraModel> load_chosen_camera(const std::filesystem::path& file, const std::string& name) {
  PENUMBRA_TRY(LoadedCamera loaded, load_camera_file(file, name));
  for (const std::string& warning : loaded.warnings) log_warning("{}", warning);
  return std::move(loaded.camera);
}

}  // namespace penumbra
