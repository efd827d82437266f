// Error of a tag map against the true tags, independent of its table frame.
#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "core/geometry/tag_map.hpp"

namespace penumbra::test {

// Returns the largest distance between corners of the tags, after both sheets are aligned.
inline double largest_error_m(const TagMap& map, const std::vector<MappedTag>& truth) {
  Eigen::Matrix3Xd from(3, 4 * truth.size());
  Eigen::Matrix3Xd to(3, 4 * truth.size());
  for (std::size_t i = 0; i < truth.size(); ++i) {
    for (std::size_t c = 0; c < 4; ++c) {
      const auto column = static_cast<Eigen::Index>(4 * i + c);
      from.col(column) = truth[i].corners()[c];
      to.col(column) = map.tags()[i].corners()[c];
    }
  }
  const Eigen::Affine3d T(Eigen::umeyama(from, to, false));
  return (T * from - to).colwise().norm().maxCoeff();
}

}  // namespace penumbra::test
