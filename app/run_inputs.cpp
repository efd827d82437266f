#include "app/run_inputs.hpp"

#include <fmt/format.h>

#include <cstdio>
#include <set>

#include "app/logging.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"

namespace penumbra {

TagsInUse tags_in_use(const std::filesystem::path& file, const TagMap& tags) {
  std::set<double> sizes;
  for (const MappedTag& tag : tags.tags()) sizes.insert(tag.size_m);
  return {file.string(), static_cast<int>(tags.tags().size()), {sizes.begin(), sizes.end()}};
}

void print_tags(const TagsInUse& tags) {
  constexpr std::size_t kMaxListed = 4;
  std::string sizes;
  if (tags.sizes_m.size() > kMaxListed) {
    sizes = fmt::format("{:.4g} to {:.4g}", tags.sizes_m.front() * 1e3, tags.sizes_m.back() * 1e3);
  } else {
    for (const double size : tags.sizes_m) {
      sizes += fmt::format("{}{:.4g}", sizes.empty() ? "" : ", ", size * 1e3);
    }
  }
  fmt::print("tags: {} ({} {} of {} mm)\n", tags.file, tags.count, tags.count == 1 ? "tag" : "tags",
             sizes);
  std::fflush(stdout);
}

Result<CameraModel> load_chosen_camera(const std::filesystem::path& file, const std::string& name) {
  PENUMBRA_TRY(LoadedCamera loaded, load_camera_file(file, name));
  for (const std::string& warning : loaded.warnings) log_warning("{}", warning);
  return std::move(loaded.camera);
}

}  // namespace penumbra
