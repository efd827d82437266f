#include "calib/solver/table_volume.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "calib/solver/intrinsics_solver.hpp"
#include "calib/target/tag_board.hpp"
#include "calib/target/target_edges.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/units.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {
namespace {

constexpr double kElevation = radians(45.0);
constexpr double kNearest_m = 0.25;
constexpr double kFurthest_m = 5.0;
constexpr double kFurther = 1.01;  // ratio of consecutive distances
constexpr double kBorder = 2.0;    // [px] from corners to the image's border

CameraPose looking_down(double distance_m) {
  const Eigen::Vector3d middle(0.0, 0.0, 0.1);  // centre of the cube
  const Eigen::Vector3d z(0.0, std::cos(kElevation), -std::sin(kElevation));
  const Eigen::Vector3d x = Eigen::Vector3d::UnitX();
  Eigen::Matrix3d R;
  R << x, z.cross(x), z;
  return {Eigen::Quaterniond(R), middle - distance_m * z};
}

std::optional<Eigen::Vector2d> project_inside(const CameraModel& camera, const Eigen::Vector3d& p) {
  const auto pixel = camera.project(p);
  if (!pixel || !is_inside({nullptr, camera.width(), camera.height()}, *pixel, kBorder))
    return std::nullopt;
  return pixel;
}

struct PointJacobians {
  Eigen::MatrixXd lens;              // 2 x parameters
  Eigen::Matrix<double, 2, 6> pose;  // as in reprojection_jacobian()
};

PointJacobians jacobians_at(const CameraModel& camera, const CameraPose& pose,
                            const Eigen::Vector3d& p_table) {
  const Eigen::Vector3d p = pose.inverse() * p_table;
  return {lens_jacobian(camera, p.head<2>() / p.z()),
          reprojection_jacobian(camera, as_map_pose(pose), p_table)};
}

double worst_sigma(const Eigen::MatrixXd& J, const Eigen::MatrixXd& covariance) {
  const Eigen::Matrix2d here = J * covariance * J.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(here);
  return std::sqrt(std::max(eigen.eigenvalues()[1], 0.0));
}

}  // namespace

double TableVolumeUncertainty::largest_known_pose_px() const {
  return std::ranges::max(known_pose_px);
}
double TableVolumeUncertainty::largest_tracked_px() const {
  return std::ranges::max(tracked_px);
}

std::optional<TableVolumeUncertainty> table_volume_uncertainty(const CameraModel& camera,
                                                               const Eigen::MatrixXd& covariance) {
  const auto cube = overlay_cube();
  TableVolumeUncertainty result;
  bool visible = false;
  for (double distance = kNearest_m; !visible && distance < kFurthest_m; distance *= kFurther) {
    result.T_table_camera = looking_down(distance);
    result.distance_m = result.T_table_camera.translation().norm();
    const auto T_camera_table = result.T_table_camera.inverse();
    visible = true;
    for (std::size_t i = 0; i < cube.size() && visible; ++i) {
      const auto pixel = project_inside(camera, T_camera_table * cube[i]);
      visible = pixel.has_value();
      if (pixel) result.corners_px[i] = *pixel;
    }
  }
  if (!visible) return std::nullopt;

  // A lens error d moves the tags' corners by J_lens d. The resulting least-squares pose error is
  // -(J_pose' J_pose)^-1 J_pose' J_lens d, with products summed over the corners.
  const auto sheet = tag_map_of(TagBoard());
  if (!sheet) return std::nullopt;
  const auto T_camera_table = result.T_table_camera.inverse();
  Matrix6d poses = Matrix6d::Zero();
  Eigen::MatrixXd mixed = Eigen::MatrixXd::Zero(6, covariance.rows());
  for (const MappedTag& tag : sheet->tags()) {
    for (const Eigen::Vector3d& corner : tag.corners()) {
      if (!project_inside(camera, T_camera_table * corner)) continue;
      const PointJacobians J = jacobians_at(camera, result.T_table_camera, corner);
      poses += J.pose.transpose() * J.pose;
      mixed += J.pose.transpose() * J.lens;
    }
  }
  const Eigen::LDLT<Matrix6d> solver(poses);
  if (solver.info() != Eigen::Success) return std::nullopt;
  const Eigen::MatrixXd pose_of_lens = -solver.solve(mixed);
  for (std::size_t i = 0; i < cube.size(); ++i) {
    const PointJacobians J = jacobians_at(camera, result.T_table_camera, cube[i]);
    result.known_pose_px[i] = worst_sigma(J.lens, covariance);
    result.tracked_px[i] = worst_sigma(J.lens + J.pose * pose_of_lens, covariance);
    if (!std::isfinite(result.known_pose_px[i]) || !std::isfinite(result.tracked_px[i]))
      return std::nullopt;
  }
  return result;
}

}  // namespace penumbra
