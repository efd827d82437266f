// Measures a tag's corners from all of its printed edges, given a camera and an approximate pose.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {

using Matrix8d = Eigen::Matrix<double, 8, 8>;

// Normal equations information * (c - c_assumed) = gradient for a tag's curvature c = (xx, xy, yy)
// [1/m]; the tag's homography and edge shifts are marginalised. See
// docs/calibration.md#curved-paper.
struct CurvatureEquations {
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  TagCurvature assumed;
};

struct MeasuredTag {
  // Outer corners of the black border on the tag's plane [px], in the order of TagDetection,
  // corrected for the edge shift of camera response, blur and ink, and for the assumed curvature.
  std::array<Eigen::Vector2d, 4> corners_px;
  Matrix8d covariance = Matrix8d::Zero();  // rows and columns: x0 y0 x1 y1 x2 y2 x3 y3 [px^2]
  // Shift from black towards white: x of the tag's vertical edges, y of its horizontal edges.
  Eigen::Vector2d edge_shift_px = Eigen::Vector2d::Zero();
  CurvatureEquations curvature;
};

// Fits a homography and two edge shifts. The data cells' edges separate the shift from the tag's
// size (docs/calibration.md#edge-shift). `T_camera_tag` must be accurate to 1/3 cell. Returns
// nullopt if cells are narrower than 2.4 px or less than 60 % of the edges are found.
// `tag`: the size and the assumed curvature.
[[nodiscard]] std::optional<MeasuredTag> measure_tag(
    ImageView luma, const CameraModel& camera, const TagPattern& pattern, const MappedTag& tag,
    const Transform<frame::Camera, frame::Tag>& T_camera_tag);

}  // namespace penumbra
