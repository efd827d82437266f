#include "render/camera_gl.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace penumbra {
namespace {

// Maximum normalised radius at which a monotonic lens model is used: 89 degrees from the axis.
constexpr double kLargestRadius = 57.0;

glm::mat4x3 columns(const Eigen::Matrix3d& linear, const Eigen::Vector3d& origin) {
  return {to_gl(Eigen::Vector3d(linear.col(0))), to_gl(Eigen::Vector3d(linear.col(1))),
          to_gl(Eigen::Vector3d(linear.col(2))), to_gl(origin)};
}

Eigen::Matrix3d plane_axes(const PlaneFrame& plane) {
  Eigen::Matrix3d axes;
  axes << plane.e1, plane.e2, plane.n;
  return axes;
}

// Returns a pixel's undistorted normalised coordinates. Beyond the valid radius of the model,
// inverts the chord of lens.glsl and CameraModel::project_extended().
Eigen::Vector2d undistorted(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  if (const auto ray = camera.unproject(pixel)) return ray->head<2>();
  const CameraParameters& p = camera.parameters();
  const Eigen::Vector2d target((pixel.x() - p.cx) / p.fx, (pixel.y() - p.cy) / p.fy);
  const double reach = std::isfinite(camera.max_radius()) ? camera.max_radius() : kLargestRadius;
  const Eigen::Vector2d edge = target.normalized() * reach;
  Eigen::Vector2d distorted;
  distort<double>(p.model, p.distortion, edge.x(), edge.y(), distorted.x(), distorted.y());
  const double chord = distorted.norm() / reach;
  return target / std::max(chord, 1e-3);
}

}  // namespace

LensUniforms make_lens(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const auto f = [](double value) { return static_cast<float>(value); };
  LensUniforms lens;
  lens.scale_offset = {f(2.0 * p.fx / p.width), f(2.0 * p.fy / p.height),
                       f((2.0 * p.cx + 1.0) / p.width - 1.0),
                       f((2.0 * p.cy + 1.0) / p.height - 1.0)};
  const auto& k = p.distortion;
  lens.k_low = {f(k[0]), f(k[1]), f(k[2]), f(k[3])};
  lens.k_high = {f(k[4]), f(k[5]), f(k[6]), f(k[7])};
  static_assert(static_cast<int>(DistortionModel::plumb_bob) == 0);
  if (camera.has_distortion()) lens.model = 1 + static_cast<int>(p.model);
  lens.max_radius = f(std::isfinite(camera.max_radius()) ? camera.max_radius() : kLargestRadius);
  lens.depth = {f((kFar + kNear) / (kFar - kNear)), f(-2.0 * kFar * kNear / (kFar - kNear))};
  return lens;
}

glm::vec3 to_gl(const Eigen::Vector3d& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

glm::mat3 to_gl(const Eigen::Matrix3d& m) {
  return {to_gl(Eigen::Vector3d(m.col(0))), to_gl(Eigen::Vector3d(m.col(1))),
          to_gl(Eigen::Vector3d(m.col(2)))};
}

glm::mat4x3 to_gl(const Placement& placement) {
  return columns(placement.rotation.toRotationMatrix() * placement.scale, placement.position);
}

glm::mat4x3 camera_from_object(const CameraPose& T_table_camera, const Placement& T_table_object) {
  const auto T_camera_table = T_table_camera.inverse();
  return columns(T_camera_table.rotation_matrix() * T_table_object.rotation.toRotationMatrix() *
                     T_table_object.scale,
                 T_camera_table * T_table_object.position);
}

glm::mat4x3 camera_from_plane(const CameraPose& T_table_camera, const PlaneFrame& plane) {
  const auto T_camera_table = T_table_camera.inverse();
  return columns(T_camera_table.rotation_matrix() * plane_axes(plane), T_camera_table * plane.q);
}

glm::mat4x3 plane_from_object(const PlaneFrame& plane, const Placement& T_table_object) {
  return columns(plane_axes(plane).transpose() * T_table_object.rotation.toRotationMatrix() *
                     T_table_object.scale,
                 plane.to_plane(T_table_object.position));
}

glm::vec3 inverse_depth(const CameraPose& T_table_camera, const PlaneFrame& plane) {
  // The depth z solves height(eye + z R (x, y, 1)) = 0.
  const double height = plane.height(T_table_camera.translation());
  return to_gl(Eigen::Vector3d(T_table_camera.rotation().conjugate() * plane.n / -height));
}

bool ViewFrustum::misses(std::span<const Eigen::Vector3d> hull) const {
  const auto all = [&](auto&& outside) { return std::ranges::all_of(hull, outside); };
  using P = const Eigen::Vector3d&;
  return all([](P p) { return p.z() < kNear; }) || all([](P p) { return p.z() > kFar; }) ||
         all([this](P p) { return p.x() < x_min * p.z(); }) ||
         all([this](P p) { return p.x() > x_max * p.z(); }) ||
         all([this](P p) { return p.y() < y_min * p.z(); }) ||
         all([this](P p) { return p.y() > y_max * p.z(); });
}

// Clips by the Sutherland-Hodgman algorithm; da, db: scaled distances of a, b from a side.
std::vector<Eigen::Vector3d> ViewFrustum::clipped_to_view(
    std::span<const Eigen::Vector3d> polygon) const {
  std::vector<Eigen::Vector3d> clipped(polygon.begin(), polygon.end());
  std::vector<Eigen::Vector3d> cut;
  for (const Eigen::Vector3d& inwards :
       {Eigen::Vector3d(0.0, 0.0, 1.0), Eigen::Vector3d(1.0, 0.0, -x_min),
        Eigen::Vector3d(-1.0, 0.0, x_max), Eigen::Vector3d(0.0, 1.0, -y_min),
        Eigen::Vector3d(0.0, -1.0, y_max)}) {
    cut.clear();
    for (std::size_t i = 0; i < clipped.size(); ++i) {
      const Eigen::Vector3d& a = clipped[i];
      const Eigen::Vector3d& b = clipped[(i + 1) % clipped.size()];
      const double da = inwards.dot(a);
      const double db = inwards.dot(b);
      if (da >= 0.0) cut.push_back(a);
      if ((da >= 0.0) != (db >= 0.0)) cut.emplace_back(a + da / (da - db) * (b - a));
    }
    std::swap(clipped, cut);
  }
  return clipped;
}

ViewFrustum make_frustum(const CameraModel& camera) {
  // The lens model is continuous and one-to-one, so the bounds are attained on the image's border.
  // The margin covers the border between samples and the deviation of straight edges.
  constexpr int kSteps = 8;
  const double right = camera.width() - 0.5;
  const double bottom = camera.height() - 0.5;
  Eigen::AlignedBox2d view;
  const auto include = [&](double u, double v) { view.extend(undistorted(camera, {u, v})); };
  for (int i = 0; i <= kSteps; ++i) {
    const double t = static_cast<double>(i) / kSteps;
    include(-0.5 + t * (right + 0.5), -0.5);
    include(-0.5 + t * (right + 0.5), bottom);
    include(-0.5, -0.5 + t * (bottom + 0.5));
    include(right, -0.5 + t * (bottom + 0.5));
  }
  const Eigen::Vector2d margin = 0.05 * view.sizes();
  const Eigen::Vector2d low = view.min() - margin;
  const Eigen::Vector2d high = view.max() + margin;
  return {low.x(), high.x(), low.y(), high.y()};
}

double longest_edge(const CameraModel& camera) {
  constexpr double kMaxEdge_px = 32.0;
  constexpr double kTolerance_px = 0.1;  // part of a total error budget of 0.15 px
  constexpr double kMinLength = 0.001;   // [m]
  constexpr double kMaxLength = 0.02;    // [m]
  constexpr int kSamples = 12;           // along each side of the image
  const double focal = std::max(camera.parameters().fx, camera.parameters().fy);
  double length = kMaxEdge_px / focal;  // at depth 1
  // The error of a chord's middle grows with the square of the chord's length.
  const double half = 0.5 * length;
  double worst = 0.0;
  for (int i = 0; i <= kSamples; ++i) {
    for (int j = 0; j <= kSamples; ++j) {
      const Eigen::Vector2d pixel((camera.width() - 1) * static_cast<double>(i) / kSamples,
                                  (camera.height() - 1) * static_cast<double>(j) / kSamples);
      const auto ray = camera.unproject(pixel);
      if (!ray || !(ray->z() > 0.0)) continue;
      const Eigen::Vector3d middle = *ray / ray->z();
      for (const Eigen::Vector3d& direction :
           {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0), Eigen::Vector3d(1, 1, 0),
            Eigen::Vector3d(1, -1, 0)}) {
        const Eigen::Vector3d step = half * direction.normalized();
        const auto a = camera.project(middle - step);
        const auto b = camera.project(middle + step);
        const auto m = camera.project(middle);
        if (a && b && m) worst = std::max(worst, (0.5 * (*a + *b) - *m).norm());
      }
    }
  }
  if (worst < 1e-3) return kMaxLength;  // no distortion
  if (worst > kTolerance_px) length *= std::sqrt(kTolerance_px / worst);
  return std::clamp(length * kNearestDistance, kMinLength, kMaxLength);
}

}  // namespace penumbra
