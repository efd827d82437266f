#include "tracking/alignment/map_agreement.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <numeric>
#include <optional>

#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMinComparedTags = 3;  // minimum number of tags for a comparison
constexpr std::size_t kMaxTagsForMapError =
    4;  // with more tags, one error of the map has little effect

// Returns the sum of squares per degree of freedom: three per tag, minus six of the pose.
double per_degree_of_freedom(double sum, std::size_t tags) {
  constexpr double kOfPose = 6.0;
  return sum / std::max(3.0 * static_cast<double>(tags) - kOfPose, 1.0);
}

// Returns the pose covariance by errors of lens, response and paper; see docs/tracking.md#map.
Matrix6d paper_covariance(const AlignedTag& tag, const TagEquations& equations) {
  constexpr double kShift_px = 0.05;
  constexpr double kEdge_px = 0.05;
  constexpr double kTilt_rad = 0.005;
  const double half = 0.5 * (tag.side - 1);
  const Eigen::Vector3d centre = tag.centre_point();
  const double half_px =
      half *
      std::sqrt(std::abs(tag.along_a.x() * tag.along_b.y() - tag.along_a.y() * tag.along_b.x()));
  // Columns: perturbations of one sigma about the tag's centre.
  Matrix6d paper = Matrix6d::Zero();
  paper.block<3, 1>(0, 0) = kShift_px * equations.motions.block<3, 1>(0, 0);
  paper.block<3, 1>(0, 1) = kShift_px * equations.motions.block<3, 1>(0, 1);
  paper.block<3, 1>(0, 2) = kEdge_px / half_px * centre;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d turn = kTilt_rad * Eigen::Vector3d::Unit(axis);
    paper.block<3, 1>(0, 3 + axis) = centre.cross(turn);
    paper.block<3, 1>(3, 3 + axis) = turn;
  }
  return paper * paper.transpose();
}

// Returns nullopt for a tag that does not determine a pose, for example one that the image's border
// clips.
std::optional<Matrix6d> inverse_of(const Matrix6d& H) {
  constexpr double kMinCondition = 1e-13;
  const Eigen::LDLT<Matrix6d> solver(H);
  if (!solver.isPositive() || !(solver.rcond() > kMinCondition)) return std::nullopt;
  return Matrix6d(solver.solve(Matrix6d::Identity()));
}

}  // namespace

void MapAgreement::collect(const AlignmentProblem& problem, const PoseSolver& solver) {
  equations_.clear();
  for (std::size_t k = 0; k < problem.active.size(); ++k) {
    const simd::TagPack& pack = solver.packs()[k / 4];
    const std::size_t lane = k % 4;
    const AlignedTag& tag = *problem.active[k];
    if (!pack.valid[lane] || !(tag.sums.weight > kMinWeightFraction * tag.sums.base_weight))
      continue;
    const Eigen::Vector3d centre = tag.centre_point();
    if (!(centre.z() > 0.0)) continue;
    TagEquations& added = equations_.emplace_back();
    added.index = problem.index_of(tag);
    added.H = camera_matrix([&](std::size_t h) { return pack.H_camera[h][lane]; });
    for (int i = 0; i < 6; ++i) added.g[i] = pack.g_camera[i][lane];
    added.g -= solver.slope() * (added.H * solver.last_step_of(tag));
    added.motions.setZero();
    added.motions(0, 0) = centre.z() / problem.camera.parameters().fx;
    added.motions(1, 1) = centre.z() / problem.camera.parameters().fy;
    added.motions.col(2).tail<3>() = centre.normalized();
    added.inverse = (added.motions.transpose() * added.H * added.motions).inverse();
    if (!added.inverse.allFinite()) equations_.pop_back();
  }
}

// Estimates the pose error caused by errors of the map; see docs/tracking.md#map.
void MapAgreement::estimate_map_error(const AlignmentProblem& problem, double variance,
                                      AlignmentResult& result) const {
  double tags_count = 0.0;
  Matrix6d H = Matrix6d::Zero();
  Matrix6d H_translation_square = Matrix6d::Zero();
  Matrix6d W = Matrix6d::Zero();
  Matrix6d W_translation_square = Matrix6d::Zero();
  Vector6d weighted_sum = Vector6d::Zero();
  double squares = 0.0;
  double trace = 0.0;
  for (const TagEquations& equations : equations_) {
    const std::optional<Matrix6d> H_inverse = inverse_of(equations.H);
    if (!H_inverse) continue;
    const Vector6d x = *H_inverse * equations.g;
    const AlignedTag& tag = problem.tags[static_cast<std::size_t>(equations.index)];
    const Matrix6d weight = inverse_of_spd(variance * variance_inflation(result) * *H_inverse +
                                           paper_covariance(tag, equations));
    if (!weight.allFinite() || !x.allFinite()) continue;
    tags_count += 1.0;
    H += equations.H;
    H_translation_square += equations.H.leftCols<3>() * equations.H.topRows<3>();
    W += weight;
    W_translation_square += weight.leftCols<3>() * weight.topRows<3>();
    weighted_sum += weight * x;
    squares += x.dot(weight * x);
    trace += weight.topLeftCorner<3, 3>().trace();
  }
  if (tags_count < 2.0) return;
  const Eigen::LDLT<Matrix6d> together(W);
  squares -= weighted_sum.dot(together.solve(weighted_sum));
  trace -= together.solve(W_translation_square).trace();
  const double freedom = 6.0 * (tags_count - 1.0);
  if (!(squares > freedom) || !(trace > 0.0)) return;
  const Matrix6d inverse = inverse_of_spd(H);
  // A variance estimated from three values is scaled by three (Student's t).
  constexpr double kStudentFactor = 3.0;
  const Matrix6d map_covariance =
      kStudentFactor * (squares - freedom) / trace * inverse * H_translation_square * inverse;
  if (!map_covariance.allFinite()) return;
  result.map_covariance = map_covariance;
  // 99 % quantile of chi-square (Wilson and Hilferty, The distribution of chi-square, 1931).
  constexpr double kNormal99 = 2.326;
  const double ninth = 2.0 / (9.0 * freedom);
  result.map_inconsistent =
      squares > freedom * std::pow(1.0 - ninth + kNormal99 * std::sqrt(ninth), 3.0);
}

int MapAgreement::find_outlier(double squares) const {
  const std::size_t count = equations_.size();
  // Removing one of four tags sometimes reduces pure noise to 1/9.
  const double max_ratio = count > 4 ? 1.0 / 9.0 : 1.0 / 16.0;
  constexpr std::size_t kMaxTries = 12;  // tries only the tags with the largest disagreement
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, std::greater<>(),
                           [this](std::size_t k) { return equations_[k].squares; });
  order.resize(std::min(count, kMaxTries));
  Matrix6d H_all = Matrix6d::Zero();
  Vector6d g_all = Vector6d::Zero();
  for (const TagEquations& equations : equations_) {
    H_all += equations.H;
    g_all += equations.g;
  }
  double limit = max_ratio * per_degree_of_freedom(squares, count);
  int outlier = -1;
  for (const std::size_t without : order) {
    const TagEquations& removed = equations_[without];
    const Vector6d motion = solve_spd(H_all - removed.H, g_all - removed.g);
    if (!motion.allFinite()) continue;
    double remaining = 0.0;
    for (std::size_t k = 0; k < count; ++k) {
      if (k == without) continue;
      const TagEquations& other = equations_[k];
      const Eigen::Vector3d gradient = other.motions.transpose() * (other.g - other.H * motion);
      remaining += gradient.dot(other.inverse * gradient);
    }
    if (!(per_degree_of_freedom(remaining, count - 1) < limit)) continue;
    limit = per_degree_of_freedom(remaining, count - 1);
    outlier = removed.index;
  }
  return outlier;
}

Vector6d MapAgreement::motion_for_displaced_tags(const AlignmentProblem& problem, double variance,
                                                 double sigma_m) const {
  if (equations_.size() < kMinComparedTags) return Vector6d::Zero();
  Matrix6d W = Matrix6d::Zero();
  Vector6d weighted_sum = Vector6d::Zero();
  for (const TagEquations& equations : equations_) {
    const auto H_inverse = inverse_of(equations.H);
    if (!H_inverse) continue;
    const AlignedTag& tag = problem.tags[static_cast<std::size_t>(equations.index)];
    Matrix6d covariance = variance * *H_inverse + paper_covariance(tag, equations);
    covariance.topLeftCorner<3, 3>() += sigma_m * sigma_m * Eigen::Matrix3d::Identity();
    const Matrix6d weight = inverse_of_spd(covariance);
    if (!weight.allFinite()) continue;
    W += weight;
    weighted_sum += weight * (*H_inverse * equations.g);
  }
  const Vector6d motion = W.ldlt().solve(weighted_sum);
  return motion.allFinite() ? motion : Vector6d::Zero();
}

// Compares the image shifts and rotations that the tags prefer; the response changes the scale.
void MapAgreement::check(const AlignmentProblem& problem, const PoseSolver& solver,
                         AlignmentResult& result) {
  collect(problem, solver);
  const std::size_t count = equations_.size();
  if (count > 1 && count <= kMaxTagsForMapError)
    estimate_map_error(problem, solver.variance(), result);
  if (count < kMinComparedTags) return;
  double squares = 0.0;
  double shifts_px2 = 0.0;
  for (TagEquations& equations : equations_) {
    const Eigen::Vector3d gradient = equations.motions.transpose() * equations.g;
    const Eigen::Vector3d shift = equations.inverse * gradient;
    equations.squares = gradient.dot(shift);
    squares += equations.squares;
    shifts_px2 += shift.head<2>().squaredNorm();
  }
  result.displacement_px = std::sqrt(shifts_px2 / static_cast<double>(count));
  result.disagreement = per_degree_of_freedom(squares, count) / solver.variance();
  // Lens, camera response and paper displace real tags by less than this.
  constexpr double kMinDisagreement_px = 0.1;
  if (count > kMinComparedTags && result.displacement_px >= kMinDisagreement_px &&
      result.disagreement >= kInconsistentDisagreement)
    result.inconsistent_tag = find_outlier(squares);
}

}  // namespace penumbra
