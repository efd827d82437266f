// libapriltag's description of a tag family; ArUco dictionaries get one as well.
#pragma once

#include <apriltag/apriltag.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "core/geometry/tag_map.hpp"

namespace penumbra {

using TagFamilyHandle = std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)>;

// Null when there is no memory for it.
[[nodiscard]] TagFamilyHandle make_tag_family(TagFamily family);

// Number of wrong bits at which the family's codes still differ from each other and from chance.
[[nodiscard]] int most_corrected_bits(TagFamily family);

// Codes of the first `count` (up to 1000) markers of OpenCV's DICT_4X4_1000, DICT_5X5_1000 or
// DICT_6X6_1000 (Garrido-Jurado et al., Pattern Recognition 47, 2014); `cells`: 4, 5 or 6. Cells
// row by row from the top left of the upright marker, the first one in the highest of
// cells * cells bits, 1 is white. Smaller dictionaries are the first markers of these.
[[nodiscard]] std::vector<std::uint64_t> aruco_codes(int cells, int count);

}  // namespace penumbra
