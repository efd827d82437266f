// Locates black-white edges of a printed target in an image.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <optional>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

// Returns the bilinearly interpolated grey level, or nullopt outside the image. (0, 0) is the
// centre of the top-left pixel.
[[nodiscard]] inline std::optional<double> sample_luma(ImageView luma, const Eigen::Vector2d& p) {
  if (!(p.x() >= 0.0 && p.y() >= 0.0 && p.x() <= luma.width - 1 && p.y() <= luma.height - 1))
    return std::nullopt;
  const int x = std::min(static_cast<int>(p.x()), luma.width - 2);
  const int y = std::min(static_cast<int>(p.y()), luma.height - 2);
  if (x < 0 || y < 0) return std::nullopt;
  const double u = p.x() - x;
  const double v = p.y() - y;
  const std::uint8_t* a = luma.row(y) + x;
  const std::uint8_t* b = luma.row(y + 1) + x;
  return (1.0 - v) * ((1.0 - u) * a[0] + u * a[1]) + v * ((1.0 - u) * b[0] + u * b[1]);
}

inline constexpr double kCornerBorder = 3.0;  // [px] minimum from a corner to the image's border

// Returns true if `p` is `margin` px or more inside the image.
[[nodiscard]] bool is_inside(ImageView luma, const Eigen::Vector2d& p, double margin);

// Returns d corner / d outward shift of all edges of a quadrilateral, in either winding order.
// Camera response and blur cause such a shift. Zero where two edges are nearly collinear.
[[nodiscard]] std::array<Eigen::Vector2d, 4> edge_spreads(
    const std::array<Eigen::Vector2d, 4>& corners);

// Search for an edge along `normal`, around pixel + expected * normal [px].
struct EdgeSearch {
  Eigen::Vector2d pixel;
  Eigen::Vector2d normal;
  double expected = 0.0;
  double reach = 0.0;              // half length of the search, up to 7
  double width = 0.0;              // sigma of the window that suppresses other edges
  std::optional<double> polarity;  // 1: from black to white along the normal, -1: the reverse
  double min_change = 0.0;         // minimum grey-level change within the window
};
// Returns the edge's offset from the expected position [px]: the windowed centroid of the
// grey-level change. Returns nullopt if there is no such change.
[[nodiscard]] std::optional<double> find_edge(ImageView luma, const EdgeSearch& search);

using CameraFromBoard = Transform<frame::Camera, frame::Table>;

// Follows the tag's sides along their distorted curves and returns their four intersections [px].
// `corners`: in the board frame [m]; `cells`: width of the black square. Returns nullopt if less
// than half of a side is found.
[[nodiscard]] std::optional<std::array<Eigen::Vector2d, 4>> follow_tag(
    ImageView luma, const CameraModel& camera, const CameraFromBoard& T_camera_board,
    const std::array<Eigen::Vector3d, 4>& corners, int cells);

// Returns the saddle point [px] where two edges cross. Uses each edge up to `arm_m` on both sides
// of the crossing. No third edge may be within `clearance_m` of these two.
[[nodiscard]] std::optional<Eigen::Vector2d> follow_crossing(ImageView luma,
                                                             const CameraModel& camera,
                                                             const CameraFromBoard& T_camera_board,
                                                             const Eigen::Vector3d& corner,
                                                             double arm_m, double clearance_m);

}  // namespace penumbra
