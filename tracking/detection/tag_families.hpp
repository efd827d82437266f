// Descriptions of tag families and ArUco dictionaries for libapriltag.
#pragma once

#include <apriltag/apriltag.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "core/geometry/tag_map.hpp"

namespace penumbra {

using TagFamilyHandle = std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)>;

// Returns null if memory allocation fails.
[[nodiscard]] TagFamilyHandle make_tag_family(TagFamily family);

// Returns how many wrong bits can be corrected without confusing codes or random patterns.
[[nodiscard]] int max_corrected_bits(TagFamily family);

// Returns the codes of the first `count` (up to 1000) markers of OpenCV's DICT_4X4_1000,
// DICT_5X5_1000 or DICT_6X6_1000 (Garrido-Jurado et al., Pattern Recognition 47, 2014); `cells`: 4,
// 5 or 6. The highest of the cells * cells bits is the top left cell of the upright marker; the
// others follow row by row; 1 is white. Smaller dictionaries are prefixes of these dictionaries.
[[nodiscard]] std::vector<std::uint64_t> aruco_codes(int cells, int count);

}  // namespace penumbra
