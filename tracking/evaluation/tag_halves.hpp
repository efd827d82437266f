// Splits the tags of a sheet into two disjoint halves that both span it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

namespace penumbra {

struct WeightedTag {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // centre on the map [m]
  double weight = 1.0;                                 // fraction of the frames that show it, > 0
};

// Indices into the list of tags; both ascend. Their sizes differ by at most one.
using TagHalves = std::array<std::vector<std::size_t>, 2>;

// Returns up to `count` different splits, best balanced first. The same tags give the same splits.
// Fewer than four tags give none. See docs/tracking.md#split-halves.
[[nodiscard]] std::vector<TagHalves> balanced_halves(std::span<const WeightedTag> tags, int count);

}  // namespace penumbra
