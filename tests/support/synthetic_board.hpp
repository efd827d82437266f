// A board of tags, a camera with lens distortion and random poses, for tests with exact truth.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <random>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/units.hpp"
#include "tracking/alignment/pattern_renderer.hpp"
#include "tracking/alignment/tag_pattern.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/math/se3.hpp"

namespace penumbra::test {

// A camera of 1280x720 px with radial-tangential distortion.
inline CameraModel wide_camera() {
  CameraParameters p;
  p.width = 1280;
  p.height = 720;
  p.fx = 980.0;
  p.fy = 976.0;
  p.cx = 644.0;
  p.cy = 355.0;
  p.distortion = {-0.19, 0.055, 0.0007, -0.0005, -0.003, 0.0, 0.0, 0.0};
  return CameraModel::make(p).value();
}

// `columns` x `rows` tags of size `size_m` with gaps of a third of the size; ids from 0.
inline std::vector<MappedTag> board(int columns, int rows, double size_m) {
  std::vector<MappedTag> tags;
  const double pitch = size_m * 4.0 / 3.0;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      MappedTag tag;
      tag.id = j * columns + i;
      tag.size_m = size_m;
      tag.T_table_tag = {
          Eigen::Quaterniond::Identity(),
          Eigen::Vector3d((i - 0.5 * (columns - 1)) * pitch, (0.5 * (rows - 1) - j) * pitch, 0.0)};
      tags.push_back(tag);
    }
  }
  return tags;
}

// Camera that looks at `target` from `distance_m`, at `elevation` above the table and `azimuth`,
// rotated by `roll` about its optical axis.
inline CameraPose looking_at(const Eigen::Vector3d& target, double distance_m, double elevation,
                             double azimuth, double roll) {
  const Eigen::Vector3d away(std::cos(elevation) * std::cos(azimuth),
                             std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
  const Eigen::Vector3d z = -away;
  Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ());
  if (x.norm() < 1e-6) x = Eigen::Vector3d::UnitX();
  x.normalize();
  Eigen::Matrix3d R;
  R << x, z.cross(x), z;
  R = R * Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return {R, target + distance_m * away};
}

// Random view of a board of six 60 mm tags; cells are about 10 px wide.
inline CameraPose random_view(std::mt19937_64& random) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  return looking_at({0.03 * (u(random) - 0.5), 0.03 * (u(random) - 0.5), 0.0},
                    0.55 + 0.12 * u(random), radians(40.0 + 40.0 * u(random)),
                    radians(360.0 * u(random)), radians(30.0 * (u(random) - 0.5)));
}

// Mean distance between the tags' corners projected with both poses [px].
inline double corner_distance_px(const CameraModel& camera, std::span<const MappedTag> tags,
                                 const CameraPose& a, const CameraPose& b) {
  double sum = 0.0;
  int count = 0;
  for (const MappedTag& tag : tags) {
    for (const Eigen::Vector3d& corner : tag.corners()) {
      const auto pa = camera.project(a.inverse() * corner);
      const auto pb = camera.project(b.inverse() * corner);
      if (!pa || !pb) continue;
      sum += (*pa - *pb).norm();
      ++count;
    }
  }
  return count > 0 ? sum / count : 1e9;
}

// Returns the pose displaced by a random motion in all six degrees of freedom. It moves the tags'
// corners by `distance_px` on average.
inline CameraPose displaced(const CameraModel& camera, std::span<const MappedTag> tags,
                            const CameraPose& pose, double distance_px, std::mt19937_64& random) {
  std::normal_distribution<double> n(0.0, 1.0);
  Vector6d direction;
  // These scales let translation [m] and rotation [rad] move the image by similar amounts.
  for (int k = 0; k < 3; ++k) direction[k] = 0.6 * n(random);
  for (int k = 3; k < 6; ++k) direction[k] = n(random);
  double low = 0.0;
  double high = 1.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    const double distance =
        corner_distance_px(camera, tags, pose, perturbed(pose, direction * middle));
    (distance < distance_px ? low : high) = middle;
  }
  return perturbed(pose, direction * low);
}

// Returns a diagonal covariance with these standard deviations of translation [m] and rotation
// [rad].
inline Matrix6d loose_prior(double metres, double angle) {
  Matrix6d P = Matrix6d::Zero();
  P.diagonal().head<3>().setConstant(metres * metres);
  P.diagonal().tail<3>().setConstant(angle * angle);
  return P;
}

// Derivative of each pixel's light [grey levels] by each parameter of a right perturbation of
// T_table_camera [m, rad]. An edge of the pattern moves across the point spread function (a
// Gaussian of lens_blur_px, convolved with the pixel's box); its contrast scales the derivative.
// The derivative is analytic, because differences of sampled images contain sampling noise, which
// would count as information. It includes the tags' edges but not the sheet's.
inline std::array<std::vector<double>, 6> light_derivatives(const CameraModel& camera,
                                                            std::span<const MappedTag> tags,
                                                            const CameraPose& pose,
                                                            const PatternRenderOptions& options) {
  std::array<std::vector<double>, 6> derivative;
  for (auto& d : derivative)
    d.assign(static_cast<std::size_t>(camera.width() * camera.height()), 0.0);
  const double sigma = options.lens_blur_px;
  const int radius = static_cast<int>(std::ceil(5.0 * sigma)) + 1;
  // Integral of the point spread function over a pixel, in one dimension.
  const auto pixel_weight = [sigma](double u) {
    const auto cdf = [sigma](double x) { return 0.5 * std::erfc(-x / (sigma * std::sqrt(2.0))); };
    return cdf(u + 0.5) - cdf(u - 0.5);
  };
  const double jump = 255.0 * options.gain * (options.black - options.white);
  const auto T_camera_table = pose.inverse();
  for (const MappedTag& tag : tags) {
    const TagPattern pattern = TagPattern::make(tag.family, tag.id).value();
    const double cell_m = tag.size_m / pattern.width_at_border();
    const double half = 0.5 * pattern.total_width();
    const auto camera_point = [&](double along, double across, bool vertical) {
      const Eigen::Vector2d ab =
          vertical ? Eigen::Vector2d(across, along) : Eigen::Vector2d(along, across);
      const Eigen::Vector3d p(cell_m * (ab.x() - half), cell_m * (ab.y() - half), 0.0);
      return Eigen::Vector3d(T_camera_table * (tag.T_table_tag * p));
    };
    for (const EdgeRun& run : pattern.runs()) {
      constexpr int kStepsPerCell = 16;  // less than half a pixel for cells of 6 px
      const int steps = kStepsPerCell * (run.end - run.begin);
      constexpr double kStep = 1.0 / kStepsPerCell;
      for (int i = 0; i < steps; ++i) {
        const double along = run.begin + (i + 0.5) * kStep;
        const Eigen::Vector3d p = camera_point(along, run.position, run.vertical);
        Eigen::Matrix<double, 2, 3> J;
        const Eigen::Vector2d q = camera.project_unchecked(p, &J);
        const Eigen::Vector2d tangent =
            J * (camera_point(along + 0.5 * kStep, run.position, run.vertical) -
                 camera_point(along - 0.5 * kStep, run.position, run.vertical));
        // Points towards white; as long as the step along the edge.
        Eigen::Vector2d normal(-tangent.y(), tangent.x());
        const Eigen::Vector2d across =
            J * (camera_point(along, run.position + 1.0, run.vertical) - p);
        if ((normal.dot(across) > 0.0) != (run.polarity > 0)) normal = -normal;
        Eigen::Matrix<double, 3, 6> moves;  // derivative of p by the perturbation
        moves << -Eigen::Matrix3d::Identity(), skew(p);
        const Eigen::Matrix<double, 1, 6> swept = jump * normal.transpose() * J * moves;
        const int cx = static_cast<int>(std::lround(q.x()));
        const int cy = static_cast<int>(std::lround(q.y()));
        for (int y = std::max(0, cy - radius); y <= std::min(camera.height() - 1, cy + radius);
             ++y) {
          const double weight_y = pixel_weight(y - q.y());
          for (int x = std::max(0, cx - radius); x <= std::min(camera.width() - 1, cx + radius);
               ++x) {
            const double weight = weight_y * pixel_weight(x - q.x());
            const auto pixel = static_cast<std::size_t>(y * camera.width() + x);
            for (std::size_t k = 0; k < 6; ++k)
              derivative[k][pixel] += weight * swept[static_cast<Eigen::Index>(k)];
          }
        }
      }
    }
  }
  return derivative;
}

// Cramer-Rao bound of a pose's covariance from one image with white noise of `noise` [grey levels].
// Gain and offset of each tag are unknown.
inline Matrix6d pose_bound(PatternRenderer& renderer, const CameraModel& camera,
                           std::span<const MappedTag> tags, const CameraPose& pose,
                           PatternRenderOptions options, double noise) {
  options.samples = 256;  // samples per pixel of `light`, the derivative by the gain
  const std::array<CameraPose, 1> centre = {pose};
  const std::vector<double> light = renderer.render_light(centre, options);
  const std::array<std::vector<double>, 6> derivative =
      light_derivatives(camera, tags, pose, options);
  Matrix6d information = Matrix6d::Zero();
  for (const MappedTag& tag : tags) {
    // Pixels of this tag: its black square and half the margin.
    double x0 = 1e9, y0 = 1e9, x1 = -1e9, y1 = -1e9;
    for (const Eigen::Vector3d& corner : tag.corners()) {
      const Eigen::Vector3d centre_of = tag.T_table_tag.translation();
      const auto p = camera.project(pose.inverse() * (centre_of + 1.12 * (corner - centre_of)));
      if (!p) return Matrix6d::Constant(1e9);
      x0 = std::min(x0, p->x());
      x1 = std::max(x1, p->x());
      y0 = std::min(y0, p->y());
      y1 = std::max(y1, p->y());
    }
    Eigen::Matrix<double, 8, 8> H = Eigen::Matrix<double, 8, 8>::Zero();
    for (int y = std::max(0, static_cast<int>(y0));
         y <= std::min(camera.height() - 1, static_cast<int>(y1)); ++y) {
      for (int x = std::max(0, static_cast<int>(x0));
           x <= std::min(camera.width() - 1, static_cast<int>(x1)); ++x) {
        const auto ray = camera.unproject({x, y});
        if (!ray) continue;
        // Skips pixels outside this tag's area of the sheet.
        const auto T_tag_camera = tag.T_table_tag.inverse() * pose;
        const Eigen::Vector3d c = T_tag_camera.translation();
        const Eigen::Vector3d d = T_tag_camera.rotation() * *ray;
        const Eigen::Vector3d hit = c - d * (c.z() / d.z());
        if (std::max(std::abs(hit.x()), std::abs(hit.y())) > 0.56 * tag.size_m) continue;
        const auto i = static_cast<std::size_t>(y * camera.width() + x);
        Eigen::Matrix<double, 8, 1> J;
        for (std::size_t k = 0; k < 6; ++k) J[static_cast<Eigen::Index>(k)] = derivative[k][i];
        J[6] = light[i];
        J[7] = 1.0;
        H += J * J.transpose();
      }
    }
    information += H.topLeftCorner<6, 6>() - H.topRightCorner<6, 2>() *
                                                 H.bottomRightCorner<2, 2>().inverse() *
                                                 H.topRightCorner<6, 2>().transpose();
  }
  return noise * noise * information.inverse();
}

}  // namespace penumbra::test
