// Common interface for other libraries, luma -> T_table_camera, to compare them with our tracker in
// one run. Each library has one file; a library that is missing at build time gives no peer.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/pose_solver.hpp"

namespace penumbra::peers {

class Peer {
 public:
  virtual ~Peer() = default;
  [[nodiscard]] virtual std::optional<CameraPose> find(ImageView luma) = 0;
};

// All peers use the tags of the group `table`. Each peer converts its corners to this project's
// convention (order, and pixel (0, 0) at the centre of the top-left pixel).

// libapriltag over the full frame. The pose comes from solve_pnp or from our estimate_board_pose
// (both planar solutions, Ceres with a robust loss, rejection of inconsistent tags).
enum class PoseBy { pnp, refinement };
[[nodiscard]] std::unique_ptr<Peer> make_libapriltag(const CameraModel& camera, const TagMap& tags,
                                                     float quad_decimate, PoseBy pose_by);

// cv::aruco::detectMarkers with solve_pnp. Returns null without OpenCV's aruco module.
enum class ArucoCorners { subpix, apriltag };
[[nodiscard]] std::unique_ptr<Peer> make_aruco(const CameraModel& camera, const TagMap& tags,
                                               ArucoCorners corners);

// vpDetectorAprilTag with vpPose over all corners. Returns null without ViSP.
[[nodiscard]] std::unique_ptr<Peer> make_visp(const CameraModel& camera, const TagMap& tags,
                                              float quad_decimate);

// cv::solvePnP (SOLVEPNP_ITERATIVE: a homography or DLT, then Levenberg-Marquardt) over all points.
[[nodiscard]] std::optional<CameraPose> solve_pnp(const CameraModel& camera,
                                                  std::span<const PointObservation> points);

// Appends the corners of the tag with this id, detected at these pixels in our corner order.
// Ignores an unknown id.
void add_corners(const TagMap& tags, TagFamily family, int id,
                 const std::array<Eigen::Vector2d, 4>& corners_px,
                 std::vector<PointObservation>& points);

}  // namespace penumbra::peers
