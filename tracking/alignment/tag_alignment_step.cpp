// The equations of all tags, and one Gauss-Newton step by them.

#include "tracking/alignment/tag_alignment_state.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "tracking/math/se3.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

// A grey level's own rounding at least.
double variance_of(double cost, double weight) {
  return std::max(cost / weight, 0.25);
}

}  // namespace

// Of all active tags at the current pose, gains and offsets eliminated. `cutoff`: of Tukey's
// weights, as a share of the gain; 0: none.
void TagAligner::Impl::sum_up(double cutoff, Equations& equations) {
  const std::size_t pack_count = (active.size() + 3) / 4;
  packs.resize(pack_count);
  equations.cost = 0.0;
  equations.weight = 0.0;
  for (std::size_t k = 0; k < 4 * pack_count; ++k) {
    kernel::TagPack& pack = packs[k / 4];
    const std::size_t lane = k % 4;
    pack.weight[lane] = 0.0;
    if (k >= active.size()) {
      for (auto& h : pack.H) h[lane] = 0.0;
      continue;
    }
    Tag& tag = *active[k];
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
    if (tag.used < kFewestSamples || !(tag.gain > 1.0)) {
      for (auto& h : pack.H) h[lane] = 0.0;
      continue;
    }
    result.counters.samples_evaluated += tag.used;
    kernel::AccumulateInput in;
    std::copy(tag.lattice_from_ray.begin(), tag.lattice_from_ray.end(), in.lattice_from_ray);
    for (int c = 0; c < 3; ++c) in.centre[c] = static_cast<float>(tag.centre[c]);
    in.gain = static_cast<float>(tag.gain);
    in.offset = static_cast<float>(tag.offset);
    in.inverse_cutoff =
        cutoff > 0.0 ? static_cast<float>(1.0 / (tukey_share(cutoff) * tag.gain)) : 0.0F;
    in.reach = tag.reach;
    in.correlated = tag.correlated;
    kernel->accumulate(in, tag.samples, tag.sums);
    const kernel::Sums& sums = tag.sums;
    for (std::size_t i = 0; i < 36; ++i) pack.H[i][lane] = sums.H[i];
    for (std::size_t i = 0; i < 8; ++i) pack.g[i][lane] = sums.g[i];
    pack.weight[lane] = sums.weight;
  }
  kernel->eliminate(packs.data(), static_cast<int>(pack_count));
  std::array<double, 21> H_sum{};
  std::array<double, 6> g_sum{};
  for (std::size_t k = 0; k < active.size(); ++k) {
    if (!packs[k / 4].valid[k % 4]) continue;
    equations.cost += active[k]->sums.cost;
    equations.weight += active[k]->sums.weight;
  }
  for (const kernel::TagPack& pack : packs) {
    // Tags that are left out have zeros.
    const auto over_lanes = [](const double* four) {
      return (four[0] + four[2]) + (four[1] + four[3]);
    };
    for (std::size_t i = 0; i < H_sum.size(); ++i) H_sum[i] += over_lanes(pack.H_camera[i]);
    for (std::size_t i = 0; i < g_sum.size(); ++i) g_sum[i] += over_lanes(pack.g_camera[i]);
  }
  Matrix6d& H = equations.H;
  const double* h = H_sum.data();
  for (const auto& [row, column] : {std::pair(0, 0), std::pair(0, 3), std::pair(3, 3)}) {
    for (int p = 0; p < 3; ++p) {
      for (int q = row == column ? p : 0; q < 3; ++q, ++h)
        H(row + p, column + q) = H(column + q, row + p) = *h;
    }
  }
  equations.g = Eigen::Map<const Vector6d>(g_sum.data());
  ++result.counters.evaluations;
}

// What the residuals say of themselves; false where they are too few.
bool TagAligner::Impl::take_variance(const Equations& equations) {
  if (!(equations.weight > 12.0)) return false;
  variance = variance_of(equations.cost, equations.weight);
  information = equations.H / variance;
  return true;
}

// One step by all active tags; false where it can't be made. moved_px: how far the tags' centres
// and corners went at most.
bool TagAligner::Impl::step(double cutoff, StepBy by, double& moved_px) {
  Equations equations;
  sum_up(cutoff, equations);
  if (!take_variance(equations)) return false;
  const Vector6d deviation = log_se3(T_camera_table * T_predicted.inverse());
  step_slope = 1.0;
  if (by == StepBy::slope) measure_slope(cutoff);
  const Matrix6d H_prior = step_slope * equations.H + variance * prior_information;
  const Vector6d xi = solve_spd(H_prior, equations.g - variance * (prior_information * deviation));
  if (!xi.allFinite()) return false;
  last_step = xi;
  if (by == StepBy::slope) {
    // It may be the last, and long: what it takes off the residuals is no noise.
    const double taken = xi.dot(2.0 * equations.g - equations.H * xi);
    variance = variance_of(equations.cost - taken, equations.weight);
    information = equations.H / variance;
  }
  step_sigmas = std::sqrt(std::max(xi.dot(information * xi), 0.0));
  const Eigen::Isometry3d motion = exp_se3(xi);
  T_camera_table = motion * T_camera_table;
  follow_tags(xi, motion, moved_px);
  return true;
}

// Takes the active tags, their gains and offsets along to the current pose, from that of the last
// equations. `xi`: how far their gains and offsets go with it; `motion`: what moved them.
void TagAligner::Impl::follow_tags(const Vector6d& xi, const Eigen::Isometry3d& motion,
                                   double& moved_px) {
  kernel::CameraStep camera_step;
  std::copy(xi.data(), xi.data() + 6, camera_step.xi);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) camera_step.R[3 * r + c] = motion.linear()(r, c);
    camera_step.t[r] = motion.translation()[r];
  }
  camera_step.fx = camera.parameters().fx;
  camera_step.fy = camera.parameters().fy;
  camera_step.slope = step_slope;
  kernel->follow(camera_step, packs.data(), static_cast<int>(packs.size()));
  double moved_px2 = 0.0;
  for (std::size_t k = 0; k < active.size(); ++k) {
    const kernel::TagPack& pack = packs[k / 4];
    const std::size_t lane = k % 4;
    Tag& tag = *active[k];
    if (pack.valid[lane]) {
      // A gain of nothing or less is no tag; it is kept just above, to come back.
      tag.gain = std::max(tag.gain + pack.levels[0][lane], 1.5);
      tag.offset += pack.levels[1][lane];
    }
    moved_px2 = std::max(moved_px2, pack.moved_px2[lane]);
    place(tag);
  }
  moved_px = std::sqrt(moved_px2);
  moved_since_projection_px += moved_px;
}

}  // namespace penumbra
