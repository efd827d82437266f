// One Gauss-Newton step over all tags.

#include "tracking/tag_alignment_state.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>

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
    Eigen::Matrix<double, 8, 8> full;
    int index = 0;
    for (int p = 0; p < 8; ++p) {
      for (int q = p; q < 8; ++q, ++index) full(p, q) = full(q, p) = sums.H[index];
    }
    const Eigen::Map<const Eigen::Matrix<double, 8, 1>> gradient(sums.g);
    if (!full.allFinite() || !(sums.weight > 8.0)) continue;
    Eliminated& e = eliminated[k];
    Eigen::Matrix2d levels = full.bottomRightCorner<2, 2>();
    const double det = levels.determinant();
    if (!(det > 1e-6 * levels(0, 0) * levels(1, 1))) continue;
    e.inverse = levels.inverse();
    e.cross = full.topRightCorner<6, 2>();
    e.gradient = gradient.tail<2>();
    const Matrix6d H_tag = full.topLeftCorner<6, 6>() - e.cross * e.inverse * e.cross.transpose();
    const Vector6d g_tag = gradient.head<6>() - e.cross * e.inverse * e.gradient;
    e.adjoint.setZero();
    e.adjoint.topLeftCorner<3, 3>() = tag.R_lattice_camera / tag.cell_m;
    e.adjoint.topRightCorner<3, 3>() = skew(tag.centre) * tag.R_lattice_camera;
    e.adjoint.bottomRightCorner<3, 3>() = tag.R_lattice_camera;
    H += e.adjoint.transpose() * H_tag * e.adjoint;
    g += e.adjoint.transpose() * g_tag;
    e.valid = true;
    cost += sums.cost;
    weight += sums.weight;
  }
  ++result.counters.evaluations;
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
    const Eigen::Vector2d levels =
        e.inverse * (e.gradient - e.cross.transpose() * (e.adjoint * xi));
    // A gain of nothing or less is no tag; it is kept just above, to come back.
    tag.gain = std::max(tag.gain + levels[0], 1.5);
    tag.offset += levels[1];
  }
  const Eigen::Isometry3d motion = exp_se3(xi);
  T_camera_table = motion * T_camera_table;
  moved_px = 0.0;
  for (Tag* tag : active) {
    const double width = tag->side - 1;
    for (const Eigen::Vector2d& corner :
         {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(width, 0.0), Eigen::Vector2d(width, width),
          Eigen::Vector2d(0.0, width)}) {
      const Eigen::Vector3d p =
          tag->ray_from_lattice * Eigen::Vector3d(corner.x(), corner.y(), 1.0);
      const Eigen::Vector3d q = motion * p;
      if (!(p.z() > 0.0 && q.z() > 0.0)) continue;
      const Eigen::Vector2d shift((q.x() / q.z() - p.x() / p.z()) * camera.parameters().fx,
                                  (q.y() / q.z() - p.y() / p.z()) * camera.parameters().fy);
      moved_px = std::max(moved_px, shift.norm());
    }
    place(*tag);
  }
  moved_since_projection_px += moved_px;
  return true;
}

}  // namespace penumbra
