// The tag map and the camera file of a run.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

struct TagsInUse {
  std::string file;
  int count = 0;
  std::vector<double> sizes_m;  // distinct, ascending
};
[[nodiscard]] TagsInUse tags_in_use(const std::filesystem::path& file, const TagMap& tags);
// Prints "tags: tags.yaml (12 tags of 40 mm)".
void print_tags(const TagsInUse& tags);

// Remedy at the end of messages about a missing tag map.
inline constexpr std::string_view kTagMapRemedy =
    "name the tag map with --tags FILE (penumbra target writes one with the sheet, penumbra map "
    "measures one)";

// Calls load_camera_file() and logs its warnings.
[[nodiscard]] Result<CameraModel> load_chosen_camera(const std::filesystem::path& file,
                                                     const std::string& name);
}  // namespace penumbra
