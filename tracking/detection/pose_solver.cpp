#include "tracking/detection/pose_solver.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <optional>

namespace penumbra {
namespace {

// Principal axes of points: origin at their centroid, z along the smallest spread.
struct Spread {
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
  Eigen::Matrix3d R_map_principal = Eigen::Matrix3d::Identity();
  Eigen::Vector3d deviation = Eigen::Vector3d::Zero();  // [m] RMS along the axes; descending
};

Spread spread_of(const std::vector<PointObservation>& points) {
  Spread spread;
  for (const PointObservation& point : points) spread.centroid += point.p_map;
  spread.centroid /= static_cast<double>(points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const PointObservation& point : points) {
    const Eigen::Vector3d d = point.p_map - spread.centroid;
    scatter += d * d.transpose();
  }
  scatter /= static_cast<double>(points.size());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);  // ascending
  spread.R_map_principal.col(0) = eigen.eigenvectors().col(2);
  spread.R_map_principal.col(1) = eigen.eigenvectors().col(1);
  spread.R_map_principal.col(2) =
      spread.R_map_principal.col(0).cross(spread.R_map_principal.col(1));
  spread.deviation = eigen.eigenvalues().reverse().cwiseMax(0.0).cwiseSqrt();
  return spread;
}

struct Candidate {
  MapFromCamera pose;
  double error = 0.0;  // sum of squared errors of the rays' x and y at z = 1
};

}  // namespace

std::vector<MapFromCamera> solve_pose(const CameraModel& camera,
                                      std::span<const PointObservation> observations) {
  std::vector<PointObservation> points;
  std::vector<Eigen::Vector2d> rays;  // undistorted, z = 1
  for (const PointObservation& observation : observations) {
    if (!observation.p_map.allFinite()) continue;
    const std::optional<Eigen::Vector3d> ray = camera.unproject(observation.pixel);
    if (!ray) continue;
    points.push_back(observation);
    rays.emplace_back(ray->x(), ray->y());
  }
  if (points.size() < 4) return {};
  const Spread spread = spread_of(points);
  if (!spread.deviation.allFinite() || !(spread.deviation[1] > 1e-3 * spread.deviation[0]) ||
      !(spread.deviation[0] > 0.0))
    return {};  // collinear or coincident points
  const double flatness = spread.deviation[2] / spread.deviation[1];

  std::vector<cv::Point2d> image;
  for (const Eigen::Vector2d& ray : rays) image.emplace_back(ray.x(), ray.y());
  std::vector<Candidate> candidates;
  const auto solve = [&](bool planar) {
    std::vector<cv::Point3d> object;
    for (const PointObservation& point : points) {
      const Eigen::Vector3d p =
          spread.R_map_principal.transpose() * (point.p_map - spread.centroid);
      object.emplace_back(p.x(), p.y(), planar ? 0.0 : p.z());
    }
    std::vector<cv::Mat> rotations;
    std::vector<cv::Mat> translations;
    try {
      cv::solvePnPGeneric(object, image, cv::Matx33d::eye(), cv::noArray(), rotations, translations,
                          false, planar ? cv::SOLVEPNP_IPPE : cv::SOLVEPNP_SQPNP);
    } catch (const std::exception&) {
      return;  // OpenCV throws for points without a pose
    }
    for (std::size_t i = 0; i < rotations.size(); ++i) {
      const Eigen::Vector3d r(rotations[i].ptr<double>());
      const Eigen::Vector3d t(translations[i].ptr<double>());
      if (!r.allFinite() || !t.allFinite()) continue;
      const double angle = r.norm();
      Eigen::Matrix3d R_camera_principal = Eigen::Matrix3d::Identity();
      if (angle > 0.0) R_camera_principal = Eigen::AngleAxisd(angle, r / angle).toRotationMatrix();
      const Eigen::Matrix3d R_camera_map = R_camera_principal * spread.R_map_principal.transpose();
      const Eigen::Vector3d t_camera_map = t - R_camera_map * spread.centroid;
      Candidate candidate;
      candidate.pose = Transform<frame::Camera, frame::Map>(R_camera_map, t_camera_map).inverse();
      bool in_front = true;
      for (std::size_t k = 0; k < points.size(); ++k) {
        const Eigen::Vector3d p = R_camera_map * points[k].p_map + t_camera_map;
        in_front = in_front && p.z() > 0.0;
        candidate.error += (p.head<2>() / p.z() - rays[k]).squaredNorm();
      }
      if (in_front && std::isfinite(candidate.error)) candidates.push_back(candidate);
    }
  };
  constexpr double kPlanar = 0.002;
  constexpr double kNearlyPlanar = 0.1;
  if (flatness < kNearlyPlanar) solve(true);
  if (flatness > kPlanar) solve(false);
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.error < b.error; });
  std::vector<MapFromCamera> poses;
  for (const Candidate& candidate : candidates) poses.push_back(candidate.pose);
  return poses;
}

}  // namespace penumbra
