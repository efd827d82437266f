#include "app/tags_in_use.hpp"

#include <fmt/format.h>

#include <cstdio>
#include <set>
#include <string_view>
#include <system_error>

namespace penumbra {

TagsInUse tags_in_use(const std::filesystem::path& file, const TagMap& tags) {
  std::set<double> sizes;
  for (const MappedTag& tag : tags.tags()) sizes.insert(tag.size_m);
  return {file.string(), static_cast<int>(tags.tags().size()), {sizes.begin(), sizes.end()}};
}

void print_tags(const TagsInUse& tags) {
  constexpr std::size_t kMostListed = 4;
  std::string sizes;
  if (tags.sizes_m.size() > kMostListed) {
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

Result<std::filesystem::path> tags_for_camera(const std::optional<std::filesystem::path>& named,
                                              const std::string& camera,
                                              const std::filesystem::path& calibration) {
  if (named) return *named;
  constexpr std::string_view kRecording = "recording:";
  std::error_code ignored;
  std::string looked_for;
  if (camera.starts_with(kRecording)) {
    const auto own = std::filesystem::path(camera.substr(kRecording.size())) / "tags.yaml";
    if (std::filesystem::exists(own, ignored)) return own;
    looked_for = own.string() + ", ";
  }
  const auto beside = calibration.parent_path() / "tags.yaml";
  if (std::filesystem::exists(beside, ignored)) return beside;
  return fail("--tags: no tag map is named, and there is no {}{}; {}", looked_for, beside.string(),
              kNameATagMap);
}

}  // namespace penumbra
