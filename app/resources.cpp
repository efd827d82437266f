#include "app/resources.hpp"

#include <cstdlib>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

// The folder of installed data, relative to the program's folder.
constexpr const char* kInstalledData = PENUMBRA_DATA_FROM_PROGRAM;

bool holds_resources(const fs::path& folder) {
  std::error_code ignored;
  return fs::is_regular_file(folder / "scenes" / "default.json", ignored);
}

}  // namespace

Result<fs::path> find_resources_of(const fs::path& program, const char* given) {
  if (given != nullptr && *given != '\0') {
    if (holds_resources(given)) return fs::path(given);
    return fail(
        "PENUMBRA_RESOURCES: {}: holds no scenes/default.json; set it to the folder that does, or "
        "unset it",
        given);
  }
  const fs::path folder = program.parent_path();
  const fs::path installed = (folder / kInstalledData).lexically_normal();
  if (holds_resources(installed)) return installed;
  for (fs::path above = folder;; above = above.parent_path()) {
    if (holds_resources(above)) return above;
    if (above == above.parent_path()) break;
  }
  return fail(
      "{}: the program's scenes/ are neither in {} nor in a folder above the program; set "
      "PENUMBRA_RESOURCES to the folder that holds them",
      program.string(), installed.string());
}

Result<fs::path> find_resources() {
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  if (error) {
    return fail("/proc/self/exe: {}; set PENUMBRA_RESOURCES to the folder of scenes/",
                error.message());
  }
  // NOLINTNEXTLINE(concurrency-mt-unsafe): the environment is written only before the first thread
  return find_resources_of(program, std::getenv("PENUMBRA_RESOURCES"));
}

Result<fs::path> find_bundled_recording_in(const fs::path& resources, std::string_view name) {
  const fs::path recording = resources / "recordings" / name;
  std::error_code ignored;
  if (fs::is_directory(recording, ignored)) return recording;
  return fail(
      "{}: the bundled recording is not installed; install the package penumbra-data, or set "
      "PENUMBRA_RESOURCES to a folder that has it",
      recording.string());
}

Result<fs::path> find_bundled_recording(std::string_view name) {
  PENUMBRA_TRY(const auto resources, find_resources());
  return find_bundled_recording_in(resources, name);
}

}  // namespace penumbra
