// A tag's corners from every edge that is printed on it, once camera and pose are known nearly.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {

using Matrix8d = Eigen::Matrix<double, 8, 8>;

struct MeasuredTag {
  // Where the outer corners of the black border are [px], in the order of TagDetection; what tone
  // curve, blur and ink do to edges is taken out of them.
  std::array<Eigen::Vector2d, 4> corners_px;
  Matrix8d covariance = Matrix8d::Zero();  // of x0 y0 x1 y1 x2 y2 x3 y3 [px^2]
  // By which black reaches into white, across the tag's upright edges and across its level ones.
  Eigen::Vector2d edge_shift_px = Eigen::Vector2d::Zero();
};

// Tone curve, blur and ink move all edges of black into white alike, which makes the tag's square
// look larger or smaller than it is; but they also move the edges of the data cells, half of them
// the other way. So size and shift are told apart within each tag. `T_camera_tag` must be right to
// about a third of a cell. Nothing where cells are narrower than 2.4 px, or where less than 60 % of
// the edges are found.
[[nodiscard]] std::optional<MeasuredTag> measure_tag(
    ImageView luma, const CameraModel& camera, const TagPattern& pattern, double size_m,
    const Transform<frame::Camera, frame::Tag>& T_camera_tag);

}  // namespace penumbra
