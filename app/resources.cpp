#include "app/resources.hpp"

#include <cstdlib>

namespace penumbra {
namespace {

namespace fs = std::filesystem;

bool holds_resources(const fs::path& folder) {
  std::error_code ignored;
  return fs::is_directory(folder / "scenes", ignored) &&
         fs::is_directory(folder / "recordings", ignored);
}

}  // namespace

Result<fs::path> find_resources_of(const fs::path& program, const char* given) {
  if (given != nullptr && *given != '\0') {
    if (holds_resources(given)) return fs::path(given);
    return fail(
        "PENUMBRA_RESOURCES: {}: holds no scenes/ and recordings/; set it to the folder that does, "
        "or unset it",
        given);
  }
  const fs::path folder = program.parent_path();
  const fs::path installed = folder.parent_path() / "share" / "penumbra";
  if (holds_resources(installed)) return installed;
  for (fs::path above = folder;; above = above.parent_path()) {
    if (holds_resources(above)) return above;
    if (above == above.parent_path()) break;
  }
  return fail(
      "{}: the program's scenes/ and recordings/ are neither in {} nor in a folder above it; set "
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

}  // namespace penumbra
