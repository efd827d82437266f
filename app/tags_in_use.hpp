// The tag map that a run tracks by, and its lines in the output and the report.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

struct TagsInUse {
  std::string file;
  int count = 0;
  std::vector<double> sizes_m;  // each size once, the smallest first
};
[[nodiscard]] TagsInUse tags_in_use(const std::filesystem::path& file, const TagMap& tags);
// "tags: tags.yaml (12 tags of 40 mm)", a line on standard output.
void print_tags(const TagsInUse& tags);

// Remedy for a missing tag map: the end of a message.
inline constexpr std::string_view kNameATagMap =
    "name what lies on the table with --tags FILE (penumbra target writes such a file with the "
    "sheet, penumbra map measures one)";

// The map for a camera: the one that is named (--tags), that of the recording that is played as a
// camera ("recording:FOLDER"), or tags.yaml beside the calibration. Fails where there is none.
[[nodiscard]] Result<std::filesystem::path> tags_for_camera(
    const std::optional<std::filesystem::path>& named, const std::string& camera,
    const std::filesystem::path& calibration);

}  // namespace penumbra
