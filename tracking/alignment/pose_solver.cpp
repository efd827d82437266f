#include "tracking/alignment/pose_solver.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>

#include "core/assert.hpp"
#include "tracking/math/se3.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

// The minimum is the square of the maximum rounding error of grey levels.
double variance_of(double cost, double weight) {
  return std::max(cost / weight, 0.25);
}

// Typical acceleration of a hand-held camera within a read-out (1 sigma).
constexpr double kAcceleration_m_s2 = 2.0;
constexpr double kAcceleration_rad_s2 = 15.0;

// Calls each(tag, k) for about `count` samples of the latest equations, evenly over all tags.
template <class Each>
void visit_evenly(const std::vector<AlignedTag*>& tags, int count, const Each& each) {
  int total = 0;
  for (const auto* tag : tags) total += tag->used;
  const int stride = std::max(1, (total + count - 1) / count);
  int next = 0;
  for (const auto* tag : tags) {
    if (tag->used < kMinSamples || !(tag->gain > 1.5)) continue;  // no equations
    for (; next < tag->used; next += stride) each(*tag, next);
    next -= tag->used;
  }
}

}  // namespace

void PoseSolver::begin() {
  variance_ = 0.0;
  noise_share_ = 0.0;
}

double PoseSolver::tukey_share(double cutoff) const {
  return noise_share_ > 0.0 ? std::clamp(4.685 * noise_share_, 0.03, cutoff) : cutoff;
}

void PoseSolver::fill_pack(AlignedTag& tag, double cutoff, simd::TagPack& pack, std::size_t lane) {
  for (int r = 0; r < 3; ++r) {
    const auto row = static_cast<std::size_t>(3 * r);
    for (int c = 0; c < 3; ++c) {
      const auto i = row + static_cast<std::size_t>(c);
      pack.R[i][lane] = tag.R_lattice_camera(r, c);
      pack.ray_from_lattice[i][lane] = tag.ray_from_lattice(r, c);
    }
    pack.centre[r][lane] = tag.centre[r];
  }
  pack.per_cell[lane] = 1.0 / tag.cell_m;
  pack.side_cells[lane] = tag.side - 1;
  if (tag.used < kMinSamples || !(tag.gain > 1.0)) {
    for (auto& h : pack.H) h[lane] = 0.0;
    return;
  }
  simd::AccumulateInput in;
  std::ranges::copy(tag.lattice_from_ray, in.lattice_from_ray);
  for (int c = 0; c < 3; ++c) in.centre[c] = static_cast<float>(tag.centre[c]);
  in.gain = static_cast<float>(tag.gain);
  in.offset = static_cast<float>(tag.offset);
  in.inverse_cutoff =
      cutoff > 0.0 ? static_cast<float>(1.0 / (tukey_share(cutoff) * tag.gain)) : 0.0F;
  in.reach = tag.reach;
  in.correlated = tag.correlated;
  problem_.loops->accumulate(in, tag.samples, tag.sums);
  const simd::Sums& sums = tag.sums;
  for (std::size_t i = 0; i < 36; ++i) pack.H[i][lane] = sums.H[i];
  for (std::size_t i = 0; i < 8; ++i) pack.g[i][lane] = sums.g[i];
  pack.weight[lane] = sums.weight;
}

// Accumulates the equations of all active tags at the current pose.
void PoseSolver::accumulate(double cutoff, Equations& equations) {
  const std::vector<AlignedTag*>& active = problem_.active;
  const std::size_t pack_count = (active.size() + 3) / 4;
  packs_.resize(pack_count);
  equations.cost = 0.0;
  equations.weight = 0.0;
  for (std::size_t k = 0; k < 4 * pack_count; ++k) {
    simd::TagPack& pack = packs_[k / 4];
    const std::size_t lane = k % 4;
    pack.weight[lane] = 0.0;
    if (k < active.size()) {
      fill_pack(*active[k], cutoff, pack, lane);
    } else {
      for (auto& h : pack.H) h[lane] = 0.0;
    }
  }
  problem_.loops->marginalise(packs_.data(), static_cast<int>(pack_count));
  std::array<double, 21> H_sum{};
  std::array<double, 6> g_sum{};
  for (std::size_t k = 0; k < active.size(); ++k) {
    if (!packs_[k / 4].valid[k % 4]) continue;
    equations.cost += active[k]->sums.cost;
    equations.weight += active[k]->sums.weight;
  }
  for (const simd::TagPack& pack : packs_) {
    // Tags without equations contribute zeros.
    const auto over_lanes = [](const double* four) {
      return (four[0] + four[2]) + (four[1] + four[3]);
    };
    for (std::size_t i = 0; i < H_sum.size(); ++i) H_sum[i] += over_lanes(pack.H_camera[i]);
    for (std::size_t i = 0; i < g_sum.size(); ++i) g_sum[i] += over_lanes(pack.g_camera[i]);
  }
  equations.H = camera_matrix([&](std::size_t k) { return H_sum[k]; });
  equations.g = Eigen::Map<const Vector6d>(g_sum.data());
}

// Returns false for too few residuals.
bool PoseSolver::update_variance(const Equations& equations) {
  if (!(equations.weight > 12.0)) return false;
  variance_ = variance_of(equations.cost, equations.weight);
  information_ = equations.H / variance_;
  return true;
}

std::optional<PoseSolver::Step> PoseSolver::step(double cutoff, StepBy by) {
  Equations equations;
  accumulate(cutoff, equations);
  if (!update_variance(equations)) return std::nullopt;
  slope_ = by == StepBy::slope ? measured_slope(cutoff) : 1.0;
  if (problem_.motion_prior) return step_motion(equations, by);
  const Vector6d deviation = log_se3(problem_.T_camera_map * problem_.T_predicted.inverse());
  const Matrix6d H_prior = slope_ * equations.H + variance_ * problem_.prior_information;
  const Vector6d xi =
      solve_spd(H_prior, equations.g - variance_ * (problem_.prior_information * deviation));
  if (!xi.allFinite()) return std::nullopt;
  last_step_ = xi;
  if (by == StepBy::slope) {
    // The final step may be long; the residuals that it removes are not noise.
    const double removed_cost = xi.dot(2.0 * equations.g - equations.H * xi);
    variance_ = variance_of(equations.cost - removed_cost, equations.weight);
    information_ = equations.H / variance_;
  }
  Step made;
  made.sigmas = std::sqrt(std::max(xi.dot(information_ * xi), 0.0));
  const Eigen::Isometry3d motion = exp_se3(xi);
  problem_.T_camera_map = motion * problem_.T_camera_map;
  made.moved_px = follow_tags(xi, motion);
  return made;
}

// A tag that is read at the time t moves by xi + t w + t^2 a / 2. The acceleration a is estimated
// in each step, but does not move the tags. See docs/tracking.md#rolling-shutter.
std::optional<PoseSolver::Step> PoseSolver::step_motion(const Equations& equations, StepBy by) {
  using Vector18d = Eigen::Matrix<double, 18, 1>;
  using Matrix18d = Eigen::Matrix<double, 18, 18>;
  const MotionPrior& prior = *problem_.motion_prior;
  Matrix18d H = Matrix18d::Zero();
  Vector18d g = Vector18d::Zero();
  for (std::size_t k = 0; k < problem_.active.size(); ++k) {
    const simd::TagPack& pack = packs_[k / 4];
    const std::size_t lane = k % 4;
    if (!pack.valid[lane]) continue;
    AlignedTag& tag = *problem_.active[k];
    problem_.find_motion_by_velocity(tag);
    const double t = problem_.read_time_s(tag);
    Eigen::Matrix<double, 6, 18> motion;
    motion << Matrix6d::Identity(), tag.motion_by_velocity, 0.5 * t * t * Matrix6d::Identity();
    const Matrix6d H_tag = camera_matrix([&](std::size_t h) { return pack.H_camera[h][lane]; });
    Vector6d g_tag;
    for (int i = 0; i < 6; ++i) g_tag[i] = pack.g_camera[static_cast<std::size_t>(i)][lane];
    H += motion.transpose() * H_tag * motion;
    g += motion.transpose() * g_tag;
  }
  const Matrix6d acceleration_information =
      inverse_of_spd(covariance_of(kAcceleration_m_s2, kAcceleration_rad_s2));
  Matrix18d prior_information = Matrix18d::Zero();
  prior_information.topLeftCorner<12, 12>() = prior.information;
  prior_information.bottomRightCorner<6, 6>() = acceleration_information;
  Vector18d deviation = Vector18d::Zero();
  deviation.head<12>() << log_se3(problem_.T_camera_map * problem_.T_predicted.inverse()),
      prior.velocity - problem_.velocity();
  const Eigen::LLT<Matrix18d> factors(slope_ * H + variance_ * prior_information);
  const Vector18d step = factors.solve(g - variance_ * (prior_information * deviation));
  if (factors.info() != Eigen::Success || !step.allFinite()) return std::nullopt;
  last_step_ = step.head<6>();
  last_velocity_step_ = step.segment<6>(6);
  acceleration_ = step.tail<6>();
  if (by == StepBy::slope) {
    // The final step may be long; the residuals that it removes are not noise.
    const double removed_cost = step.dot(2.0 * g - H * step);
    variance_ = variance_of(equations.cost - removed_cost, equations.weight);
  }
  const Matrix18d J = H / variance_;
  motion_squares_ = step.dot(J * step);
  const Matrix6d by_acceleration =
      inverse_of_spd(J.bottomRightCorner<6, 6>() + acceleration_information);
  motion_information_ = J.topLeftCorner<12, 12>() - J.topRightCorner<12, 6>() * by_acceleration *
                                                        J.topRightCorner<12, 6>().transpose();
  const Matrix6d cross = motion_information_.topRightCorner<6, 6>();
  const Matrix6d velocity_information =
      motion_information_.bottomRightCorner<6, 6>() + prior.information.bottomRightCorner<6, 6>();
  information_ = motion_information_.topLeftCorner<6, 6>() -
                 cross * inverse_of_spd(velocity_information) * cross.transpose();
  Step made;
  made.sigmas = std::sqrt(std::max(last_step_.dot(information_ * last_step_), 0.0));
  problem_.T_camera_map = exp_se3(last_step_) * problem_.T_camera_map;
  problem_.row_velocity -= problem_.row_s * last_velocity_step_;
  made.moved_px = follow_tags_by_row(last_step_, last_velocity_step_);
  return made;
}

simd::CameraStep PoseSolver::camera_step(const Vector6d& xi,
                                         const Eigen::Isometry3d& motion) const {
  simd::CameraStep camera_step;
  std::copy(xi.data(), xi.data() + 6, camera_step.xi);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) camera_step.R[3 * r + c] = motion.linear()(r, c);
    camera_step.t[r] = motion.translation()[r];
  }
  camera_step.fx = problem_.camera.parameters().fx;
  camera_step.fy = problem_.camera.parameters().fy;
  camera_step.slope = slope_;
  return camera_step;
}

double PoseSolver::follow_tags(const Vector6d& xi, const Eigen::Isometry3d& motion) {
  problem_.loops->follow(camera_step(xi, motion), packs_.data(), static_cast<int>(packs_.size()));
  return update_tags();
}

double PoseSolver::follow_tags_by_row(const Vector6d& xi, const Vector6d& velocity_step) {
  for (std::size_t k = 0; k < problem_.active.size(); ++k) {
    AlignedTag& tag = *problem_.active[k];
    // Moves all tags of the pack by this tag's step, and keeps the result for this tag.
    simd::TagPack& pack = packs_[k / 4];
    const std::size_t lane = k % 4;
    const Vector6d step = xi + tag.motion_by_velocity * velocity_step;
    scratch_ = pack;
    problem_.loops->follow(camera_step(step, exp_se3(step)), &scratch_, 1);
    for (std::size_t level : {0U, 1U}) pack.levels[level][lane] = scratch_.levels[level][lane];
    pack.moved_px2[lane] = scratch_.moved_px2[lane];
    problem_.set_row_motion(tag);
  }
  return update_tags();
}

double PoseSolver::update_tags() {
  double moved_px2 = 0.0;
  for (std::size_t k = 0; k < problem_.active.size(); ++k) {
    const simd::TagPack& pack = packs_[k / 4];
    const std::size_t lane = k % 4;
    AlignedTag& tag = *problem_.active[k];
    if (pack.valid[lane]) {
      // Keeps the gain positive, so that the tag can recover.
      tag.gain = std::max(tag.gain + pack.levels[0][lane], 1.5);
      tag.offset += pack.levels[1][lane];
    }
    moved_px2 = std::max(moved_px2, pack.moved_px2[lane]);
    problem_.place(tag);
  }
  const double moved_px = std::sqrt(moved_px2);
  problem_.moved_since_projection_px += moved_px;
  return moved_px;
}

// Computes the median from a histogram over the leading bits of the floats, 16 classes per octave.
void PoseSolver::measure_noise() {
  constexpr std::uint32_t kShift = 19;                  // leaves 4 bits of the mantissa
  constexpr std::uint32_t kFirst = (127U - 16U) << 4U;  // 2^-16 of the gain or less
  constexpr std::size_t kClasses = 20 * 16;             // up to 2^4
  constexpr float kMinShare = 0x1p-16F;
  constexpr float kMaxShare = 0x1.fp3F;  // begin of the final class
  std::array<std::uint16_t, kClasses> histogram{};
  int count = 0;
  visit_evenly(problem_.active, 384, [&](const AlignedTag& tag, int k) {
    const auto inverse_gain = static_cast<float>(1.0 / tag.gain);
    const float share = std::min(std::abs(tag.samples.residual[k]) * inverse_gain, kMaxShare);
    ++histogram[(std::bit_cast<std::uint32_t>(std::max(share, kMinShare)) >> kShift) - kFirst];
    ++count;
  });
  if (count < 16) return;
  const double middle = 0.5 * count;
  // Searches octaves, then classes.
  int below = 0;
  std::size_t at = 0;
  for (; at + 16 < kClasses; at += 16) {
    int octave = 0;
    for (std::size_t k = 0; k < 16; ++k) octave += histogram[at + k];
    if (2 * (below + octave) >= count) break;
    below += octave;
  }
  while (at + 1 < kClasses && 2 * (below + histogram[at]) < count) below += histogram[at++];
  const auto edge = [](std::size_t position) {
    return static_cast<double>(
        std::bit_cast<float>((static_cast<std::uint32_t>(position) + kFirst) << kShift));
  };
  const double within = (middle - below) / histogram[at];
  noise_share_ = 1.4826 * (edge(at) + within * (edge(at + 1) - edge(at)));
}

// Returns the sum of d(w r) / dr divided by the sum of w; see docs/tracking.md#slope-steps.
double PoseSolver::measured_slope(double cutoff) const {
  PENUMBRA_ASSERT(cutoff > 0.0);
  constexpr double kMinSlope = 0.7;  // 0.83 for normally distributed residuals
  const double limit = tukey_share(cutoff);
  double slope = 0.0;
  double weight = 0.0;
  visit_evenly(problem_.active, 768, [&](const AlignedTag& tag, int k) {
    const double base = static_cast<double>(tag.samples.weight[k]);
    const double t = static_cast<double>(tag.samples.residual[k]) / (limit * tag.gain);
    const double inside = 1.0 - std::min(t * t, 1.0);
    weight += base * inside * inside;
    slope += base * inside * (5.0 * inside - 4.0);
  });
  return weight > 0.0 ? std::clamp(slope / weight, kMinSlope, 1.0) : 1.0;
}

}  // namespace penumbra
