#include "app/recording/recording_folder.hpp"

#include <system_error>

namespace penumbra {

Result<void> create_recording_folder(const std::filesystem::path& path, OutputFolder& folder) {
  const std::filesystem::path target = folder_name(path);
  std::error_code error;
  if (std::filesystem::exists(target, error)) {
    if (!std::filesystem::is_directory(target, error)) {
      return fail("{}: is not a folder; name a new one for the recording", path.string());
    }
    const std::filesystem::directory_iterator first(target, error);
    if (error || first != std::filesystem::directory_iterator()) {
      return fail("{}: exists and is not empty; name a new folder for the recording",
                  path.string());
    }
  }
  return folder.create(target);
}

}  // namespace penumbra
