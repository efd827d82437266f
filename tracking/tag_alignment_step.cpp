// One Gauss-Newton step over all tags.

#include "tracking/tag_alignment_state.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "tracking/se3.hpp"

namespace penumbra {

// One Gauss-Newton step over all active tags, gains and offsets eliminated. `cutoff`: of Tukey's
// weights, as a share of the gain; 0: none. moved_px: how far the tags' centres and corners went at
// most.
bool TagAligner::Impl::step(double cutoff, double& moved_px) {
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  if (eliminated.size() < active.size()) eliminated.resize(active.size());
  double cost = 0.0;
  double weight = 0.0;
  for (std::size_t k = 0; k < active.size(); ++k) {
    Tag& tag = *active[k];
    eliminated[k].valid = false;
    if (tag.used < 16 || !(tag.gain > 1.0)) continue;
    kernel::AccumulateInput in;
    std::copy(tag.lattice_from_ray.begin(), tag.lattice_from_ray.end(), in.lattice_from_ray);
    for (int c = 0; c < 3; ++c) in.centre[c] = static_cast<float>(tag.centre[c]);
    in.gain = static_cast<float>(tag.gain);
    in.offset = static_cast<float>(tag.offset);
    // Never cut into the noise itself, and no further out than it asks for.
    double limit = cutoff * tag.gain;
    if (noise_share > 0.0) limit = tag.gain * std::clamp(4.685 * noise_share, 0.03, cutoff);
    in.inverse_cutoff = cutoff > 0.0 ? static_cast<float>(1.0 / limit) : 0.0F;
    in.reach = tag.reach;
    in.correlated = tag.correlated;
    kernel->accumulate(in, tag.samples, tag.sums);
    const kernel::Sums& sums = tag.sums;
    double sum = 0.0;
    for (const double h : sums.H) sum += h;
    if (!std::isfinite(sum) || !(sums.weight > 8.0)) continue;
    Eigen::Matrix<double, 8, 8> full;
    int index = 0;
    for (int p = 0; p < 8; ++p) {
      for (int q = p; q < 8; ++q, ++index) full(p, q) = full(q, p) = sums.H[index];
    }
    const Eigen::Map<const Eigen::Matrix<double, 8, 1>> gradient(sums.g);
    Eliminated& e = eliminated[k];
    const Eigen::Matrix2d levels = full.bottomRightCorner<2, 2>();
    const double det = levels.determinant();
    if (!(det > 1e-6 * levels(0, 0) * levels(1, 1))) continue;
    e.inverse = levels.inverse();
    e.cross = full.topRightCorner<6, 2>();
    e.gradient = gradient.tail<2>();
    const Eigen::Matrix<double, 6, 2> shares = e.cross * e.inverse;
    const Vector6d g_tag = gradient.head<6>() - shares * e.gradient;
    // Into the camera's frame: the lattice's motion is [R / cell, K R; 0, R] times the camera's,
    // with K = skew(centre). The lever first, then the rotation, block by block.
    const auto cross_nu = e.cross.topRows<3>();
    const auto cross_omega = e.cross.bottomRows<3>();
    const Eigen::Matrix3d P =
        full.topLeftCorner<3, 3>() - shares.topRows<3>() * cross_nu.transpose();
    const Eigen::Matrix3d Q =
        full.block<3, 3>(0, 3) - shares.topRows<3>() * cross_omega.transpose();
    const Eigen::Matrix3d S =
        full.block<3, 3>(3, 3) - shares.bottomRows<3>() * cross_omega.transpose();
    const Eigen::Matrix3d K = skew(tag.centre);
    const Eigen::Matrix3d Q_lever = Q + P * K;
    const Eigen::Matrix3d S_lever = S + Q.transpose() * K - K * Q_lever;  // K^T = -K
    const Eigen::Matrix3d& R = tag.R_lattice_camera;
    const double per_cell = 1.0 / tag.cell_m;
    H.topLeftCorner<3, 3>() += per_cell * per_cell * (R.transpose() * P * R);
    H.topRightCorner<3, 3>() += per_cell * (R.transpose() * Q_lever * R);
    H.bottomRightCorner<3, 3>() += R.transpose() * S_lever * R;
    const Eigen::Vector3d g_nu = g_tag.head<3>();
    g.head<3>() += per_cell * (R.transpose() * g_nu);
    g.tail<3>() += R.transpose() * (g_tag.tail<3>() + g_nu.cross(tag.centre));
    e.valid = true;
    cost += sums.cost;
    weight += sums.weight;
  }
  ++result.counters.evaluations;
  H.bottomLeftCorner<3, 3>() = H.topRightCorner<3, 3>().transpose();
  if (!(weight > 12.0)) return false;
  variance = std::max(cost / weight, 0.25);  // a grey level's own rounding at least
  information = H / variance;
  const Vector6d deviation = log_se3(T_camera_table * T_predicted.inverse());
  const Matrix6d H_prior = H + variance * prior_information;
  const Vector6d xi = H_prior.ldlt().solve(g - variance * (prior_information * deviation));
  if (!xi.allFinite()) return false;
  for (std::size_t k = 0; k < active.size(); ++k) {
    const Eliminated& e = eliminated[k];
    if (!e.valid) continue;
    Tag& tag = *active[k];
    const Eigen::Vector3d omega = tag.R_lattice_camera * xi.tail<3>();
    Vector6d moved;
    moved << tag.R_lattice_camera * xi.head<3>() / tag.cell_m + tag.centre.cross(omega), omega;
    const Eigen::Vector2d levels = e.inverse * (e.gradient - e.cross.transpose() * moved);
    // A gain of nothing or less is no tag; it is kept just above, to come back.
    tag.gain = std::max(tag.gain + levels[0], 1.5);
    tag.offset += levels[1];
  }
  const Eigen::Isometry3d motion = exp_se3(xi);
  T_camera_table = motion * T_camera_table;
  double moved_px2 = 0.0;
  const Eigen::Vector2d focal(camera.parameters().fx, camera.parameters().fy);
  for (Tag* tag : active) {
    const Eigen::Vector3d across = (tag->side - 1) * tag->ray_from_lattice.col(0);
    const Eigen::Vector3d down = (tag->side - 1) * tag->ray_from_lattice.col(1);
    Eigen::Vector3d p = tag->ray_from_lattice.col(2);
    for (const Eigen::Vector3d& to_next :
         {across, down, Eigen::Vector3d(-across), Eigen::Vector3d(-down)}) {
      const Eigen::Vector3d q = motion * p;
      if (p.z() > 0.0 && q.z() > 0.0) {
        const Eigen::Vector2d shift =
            (q.head<2>() * p.z() - p.head<2>() * q.z()).cwiseProduct(focal) / (q.z() * p.z());
        moved_px2 = std::max(moved_px2, shift.squaredNorm());
      }
      p += to_next;
    }
    place(*tag);
  }
  moved_px = std::sqrt(moved_px2);
  moved_since_projection_px += moved_px;
  return true;
}

}  // namespace penumbra
