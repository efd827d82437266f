#include "benchmarks/peers/saddle_points.hpp"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <optional>

#include "core/assert.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra::peers {
namespace {

constexpr double kSigma_px = 1.3;  // Gaussian weights of the fit; 1/4 of a typical cell
constexpr double kNear_px = 2.0;   // maximum distance of a saddle from its predicted position

// Returns the saddle that repeated fits of a quadric find from `position` [px] on; nullopt if none.
std::optional<Eigen::Vector2d> saddle_near(ImageView image, Eigen::Vector2d position) {
  constexpr int kReach = 3;  // half of the fitted window's side [px]
  for (int iteration = 0; iteration < 10; ++iteration) {
    const auto x0 = static_cast<int>(std::lround(position.x()));
    const auto y0 = static_cast<int>(std::lround(position.y()));
    if (x0 < kReach || y0 < kReach || x0 >= image.width - kReach || y0 >= image.height - kReach)
      return std::nullopt;
    Eigen::Matrix<double, 6, 6> H = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> g = Eigen::Matrix<double, 6, 1>::Zero();
    for (int y = y0 - kReach; y <= y0 + kReach; ++y) {
      for (int x = x0 - kReach; x <= x0 + kReach; ++x) {
        const double dx = x - position.x();
        const double dy = y - position.y();
        const double weight = std::exp(-(dx * dx + dy * dy) / (2.0 * kSigma_px * kSigma_px));
        const Eigen::Matrix<double, 6, 1> terms{{1.0, dx, dy, dx * dx, dx * dy, dy * dy}};
        H += weight * terms * terms.transpose();
        g += weight * static_cast<double>(image.row(y)[x]) * terms;
      }
    }
    const Eigen::Matrix<double, 6, 1> quadric = H.ldlt().solve(g);
    Eigen::Matrix2d curvature;
    curvature << 2.0 * quadric[3], quadric[4], quadric[4], 2.0 * quadric[5];
    if (!(curvature.determinant() < 0.0)) return std::nullopt;
    const Eigen::Vector2d move = -curvature.inverse() * quadric.segment<2>(1);
    if (!(move.norm() < kNear_px)) return std::nullopt;
    position += move;
    if (move.norm() < 1e-3) return position;
  }
  return std::nullopt;
}

using Pose6 = std::array<double, 6>;  // angle-axis, translation

Pose6 numbers_of(const Eigen::Quaterniond& q, const Eigen::Vector3d& t) {
  const std::array<double, 4> wxyz = {q.w(), q.x(), q.y(), q.z()};
  Pose6 result{};
  ceres::QuaternionToAngleAxis(wxyz.data(), result.data());
  for (std::size_t i = 0; i < 3; ++i) result[3 + i] = t[static_cast<Eigen::Index>(i)];
  return result;
}
template <class T>
T transform_of(const Pose6& numbers) {
  std::array<double, 4> q{};
  ceres::AngleAxisToQuaternion(numbers.data(), q.data());
  return T(Eigen::Quaterniond(q[0], q[1], q[2], q[3]),
           Eigen::Vector3d(numbers[3], numbers[4], numbers[5]));
}

struct PointCost {
  const CameraParameters* lens;
  Eigen::Vector3d in_tag;
  Eigen::Vector2d pixel;
  template <class T>
  bool operator()(const T* T_camera_table, const T* T_table_tag, T* residual) const {
    const T p[3] = {T(in_tag.x()), T(in_tag.y()), T(in_tag.z())};
    T q[3];
    ceres::AngleAxisRotatePoint(T_table_tag, p, q);
    for (int i = 0; i < 3; ++i) q[i] += T_table_tag[3 + i];
    T r[3];
    ceres::AngleAxisRotatePoint(T_camera_table, q, r);
    for (int i = 0; i < 3; ++i) r[i] += T_camera_table[3 + i];
    if (!(r[2] > T(0.0))) return false;
    residual[0] = lens->fx * r[0] / r[2] + lens->cx - pixel.x();
    residual[1] = lens->fy * r[1] / r[2] + lens->cy - pixel.y();
    return true;
  }
};

// Prior that keeps the tags of one sheet parallel: a rotation by 0.1 degree (0.0017 rad) costs as
// much as a point error of 0.1 px.
struct ParallelPrior {
  template <class T>
  bool operator()(const T* T_table_tag, T* residual) const {
    residual[0] = T_table_tag[2] * (0.1 / 0.0017);
    return true;
  }
};

}  // namespace

std::vector<SaddlePoint> find_saddle_points(const CameraModel& camera,
                                            std::span<const MappedTag> tags,
                                            const CameraPose& T_table_camera, ImageView image) {
  std::vector<SaddlePoint> found;
  for (std::size_t k = 0; k < tags.size(); ++k) {
    const MappedTag& tag = tags[k];
    const Result<TagPattern> pattern = TagPattern::make(tag.family, tag.id);
    if (!pattern) continue;
    const int width = pattern->total_width();
    const double cell_m = tag.size_m / pattern->width_at_border();
    for (int j = 1; j < width; ++j) {
      for (int i = 1; i < width; ++i) {
        const bool white = pattern->white(i, j);
        if (pattern->white(i - 1, j - 1) != white || pattern->white(i - 1, j) == white ||
            pattern->white(i, j - 1) == white)
          continue;
        const Eigen::Vector3d in_tag((i - 0.5 * width) * cell_m, (j - 0.5 * width) * cell_m, 0.0);
        const auto expected = camera.project(T_table_camera.inverse() * (tag.T_table_tag * in_tag));
        if (!expected) continue;
        const auto position = saddle_near(image, *expected);
        if (position && (*position - *expected).norm() < kNear_px)
          found.push_back({static_cast<int>(k), in_tag, *position});
      }
    }
  }
  return found;
}

double adjust(const CameraModel& camera, std::span<const std::vector<SaddlePoint>> points,
              std::vector<MappedTag>& tags, std::vector<CameraPose>& poses) {
  PENUMBRA_ASSERT(points.size() == poses.size() && !camera.has_distortion() && !tags.empty());
  std::vector<Pose6> cameras;
  std::vector<Pose6> tag_poses;
  for (const CameraPose& pose : poses) {
    const auto T_camera_table = pose.inverse();
    cameras.push_back(numbers_of(T_camera_table.rotation(), T_camera_table.translation()));
  }
  for (const MappedTag& tag : tags) {
    tag_poses.push_back(numbers_of(tag.T_table_tag.rotation(), tag.T_table_tag.translation()));
    tag_poses.back()[0] = tag_poses.back()[1] = tag_poses.back()[5] =
        0.0;  // fixed in the table plane
  }
  ceres::Problem problem;
  const auto cost_of = [&](const SaddlePoint& point) {
    return new ceres::AutoDiffCostFunction<PointCost, 2, 6, 6>(
        new PointCost{&camera.parameters(), point.in_tag, point.pixel});
  };
  for (std::size_t f = 0; f < points.size(); ++f) {
    for (const SaddlePoint& point : points[f]) {
      problem.AddResidualBlock(cost_of(point), new ceres::CauchyLoss(0.25), cameras[f].data(),
                               tag_poses[static_cast<std::size_t>(point.tag)].data());
    }
  }
  for (std::size_t k = 1; k < tag_poses.size(); ++k) {
    if (!problem.HasParameterBlock(tag_poses[k].data())) continue;
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<ParallelPrior, 1, 6>(new ParallelPrior), nullptr,
        tag_poses[k].data());
    problem.SetManifold(tag_poses[k].data(), new ceres::SubsetManifold(6, {0, 1, 5}));
  }
  if (problem.HasParameterBlock(tag_poses[0].data()))
    problem.SetParameterBlockConstant(tag_poses[0].data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 100;
  options.function_tolerance = 1e-10;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);

  for (std::size_t f = 0; f < poses.size(); ++f)
    poses[f] = transform_of<decltype(poses[f].inverse())>(cameras[f]).inverse();
  for (std::size_t k = 0; k < tags.size(); ++k)
    tags[k].T_table_tag = transform_of<decltype(tags[k].T_table_tag)>(tag_poses[k]);
  double sum = 0.0;
  int count = 0;
  for (std::size_t f = 0; f < points.size(); ++f) {
    for (const SaddlePoint& point : points[f]) {
      const auto pixel =
          camera.project(poses[f].inverse() *
                         (tags[static_cast<std::size_t>(point.tag)].T_table_tag * point.in_tag));
      if (!pixel || !((*pixel - point.pixel).norm() < 1.0)) continue;
      sum += (*pixel - point.pixel).squaredNorm();
      ++count;
    }
  }
  return count > 0 ? std::sqrt(sum / count) : 0.0;
}

}  // namespace penumbra::peers
