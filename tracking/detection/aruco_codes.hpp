// The codes of the ArUco dictionaries that boards are printed with everywhere: facts that a reader
// of such boards has to share with OpenCV, which defines them (DICT_4X4_1000, DICT_5X5_1000,
// DICT_6X6_1000; made as in Garrido-Jurado et al., Automatic generation and detection of highly
// reliable fiducial markers under occlusion, Pattern Recognition 47, 2014).
#pragma once

#include <cstdint>
#include <vector>

namespace penumbra {

// Of the first `count` (up to 1000) markers of `cells` x `cells` data cells (4, 5 or 6): row by row
// from the top left of the upright marker, the first cell in the highest of cells * cells bits, 1
// is white. The smaller dictionaries (DICT_4X4_50, ...) are the first ones of the large.
[[nodiscard]] std::vector<std::uint64_t> aruco_codes(int cells, int count);

}  // namespace penumbra
