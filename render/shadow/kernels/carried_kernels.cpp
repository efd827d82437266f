#include "render/shadow/kernels/carried_kernels.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "core/assert.hpp"
#include "render/model/to_eigen.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/shadow/casters/index_groups.hpp"

namespace penumbra {
namespace {

// Vertices of a part that may be anchors, evenly spread over their order in the mesh.
constexpr std::size_t kMaxCandidates = 256;
constexpr std::size_t kMaxAnchors = 32;  // of a kernel
constexpr std::size_t kMinAnchors = 8;   // if fewer are in the disc, takes the nearest ones
// Minimum variance of the anchors along an axis, as a fraction of the greatest one.
constexpr double kMinVariance = 1e-8;
// Kernels of a part that are nearer to each other than this are one site [m].
constexpr double kSameSite_m = 1e-6;

std::size_t step_for(std::size_t count, std::size_t limit) {
  return std::max<std::size_t>(1, (count + limit - 1) / limit);
}

// Weights of anchors for a kernel on the line at + h up, whose height h is free. Anchors that an
// affine map displaces reproduce it at the kernel: the weights are the least-squares fit of the
// map, evaluated there. The height is that of the weights of least norm.
class AffineFit {
 public:
  AffineFit(std::span<const Eigen::Vector3d> anchors, const Eigen::Vector3d& at,
            const Eigen::Vector3d& up)
      : mean_(Eigen::Vector3d::Zero()), count_(static_cast<double>(anchors.size())) {
    for (const Eigen::Vector3d& x : anchors) mean_ += x / count_;
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const Eigen::Vector3d& x : anchors)
      covariance += (x - mean_) * (x - mean_).transpose() / count_;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const double largest = solver.eigenvalues()[2];
    position_ = at;
    if (!(largest > 0.0)) return;
    const Eigen::Vector3d precision =
        solver.eigenvalues().cwiseMax(kMinVariance * largest).cwiseInverse();
    const Eigen::Matrix3d& axes = solver.eigenvectors();
    const Eigen::Matrix3d inverse = axes * precision.asDiagonal() * axes.transpose();
    position_ += up.dot(inverse * (mean_ - at)) / up.dot(inverse * up) * up;
    gradient_ = inverse * (position_ - mean_);
  }
  [[nodiscard]] const Eigen::Vector3d& position() const { return position_; }
  [[nodiscard]] double weight(const Eigen::Vector3d& anchor) const {
    return (1.0 + gradient_.dot(anchor - mean_)) / count_;
  }

 private:
  Eigen::Vector3d mean_;
  double count_;
  Eigen::Vector3d position_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d gradient_ = Eigen::Vector3d::Zero();
};

bool is_float(const Eigen::Vector3d& p) {
  return (p.array().abs() <= static_cast<double>(std::numeric_limits<float>::max())).all();
}

}  // namespace

CarriedKernels::CarriedKernels(const ShadowMesh& mesh, ShadowKernels kernels)
    : first_(std::move(kernels)), positions_(mesh.positions) {
  const std::size_t count = positions_.size();
  PENUMBRA_ASSERT(first_.kernels.size() == count && mesh.part.size() == count);
  // A kernel without a disc, that of COCL, belongs to the whole mesh.
  const bool has_discs = first_.radius.size() == count;
  const std::uint32_t part_count = has_discs ? mesh.part_count : 1;
  const auto part_of = [&](std::size_t i) { return has_discs ? mesh.part[i] : 0U; };
  const PlaneFrame view = PlaneFrame::make(first_.up, Eigen::Vector3d::Zero());
  std::vector<Eigen::Vector3d> seen(count);  // (u, v, height)
  std::vector<float> radii;                  // by site
  std::map<std::array<std::int64_t, 3>, std::uint32_t> known;
  site_of_.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    seen[i] = view.to_plane(to_eigen(positions_[i]));
    const Eigen::Vector3d k = view.to_plane(to_eigen(first_.kernels[i]));
    const auto cell = [](double x) {
      constexpr double kLimit = 9e18;
      return static_cast<std::int64_t>(std::clamp(std::round(x / kSameSite_m), -kLimit, kLimit));
    };
    const auto [entry, is_new] =
        known.try_emplace({static_cast<std::int64_t>(part_of(i)), cell(k.x()), cell(k.y())},
                          static_cast<std::uint32_t>(sites_.size()));
    site_of_[i] = entry->second;
    if (is_new) {
      sites_.push_back({k, 0, 0});
      radii.push_back(0.0F);
    }
    if (has_discs) radii[entry->second] = std::max(radii[entry->second], first_.radius[i]);
  }
  IndexGroups vertices, sites;
  vertices.sort(count, part_count, part_of);
  std::vector<std::uint32_t> part_of_site(sites_.size());
  for (std::size_t i = 0; i < count; ++i) part_of_site[site_of_[i]] = part_of(i);
  sites.sort(sites_.size(), part_count, [&](std::size_t site) { return part_of_site[site]; });
  std::vector<std::uint32_t> candidates, within, chosen;
  for (std::uint32_t part = 0; part < part_count; ++part) {
    candidates.clear();
    const std::size_t step = step_for(vertices[part].size(), kMaxCandidates);
    for (std::size_t i = 0; i < vertices[part].size(); i += step)
      candidates.push_back(vertices[part][i]);
    for (const std::uint32_t index : sites[part]) {
      Site& site = sites_[index];
      const double reach = radii[index] > 0.0F
                               ? static_cast<double>(radii[index]) * (1.0 + 1e-3) + kSameSite_m
                               : std::numeric_limits<double>::infinity();
      const auto distance_to = [&](std::uint32_t i) {
        return (seen[i] - site.position).head<2>().norm();
      };
      within.clear();
      for (const std::uint32_t i : candidates) {
        if (distance_to(i) <= reach) within.push_back(i);
      }
      if (within.size() < kMinAnchors) {
        within = candidates;
        const auto nearest = static_cast<std::ptrdiff_t>(std::min(kMinAnchors, within.size()));
        std::ranges::partial_sort(within, within.begin() + nearest, {}, distance_to);
        within.resize(static_cast<std::size_t>(nearest));
      }
      chosen.clear();
      for (std::size_t i = 0; i < within.size(); i += step_for(within.size(), kMaxAnchors))
        chosen.push_back(within[i]);
      site.position = view.lift(site.position.x(), site.position.y());
      add_anchors(site, chosen);
    }
  }
}

void CarriedKernels::add_anchors(Site& site, std::span<const std::uint32_t> vertices) {
  std::vector<Eigen::Vector3d> points;
  points.reserve(vertices.size());
  for (const std::uint32_t vertex : vertices) points.push_back(to_eigen(positions_[vertex]));
  const AffineFit fit(points, site.position, first_.up);
  site.position = fit.position();
  site.first = anchors_.size();
  site.count = vertices.size();
  for (std::size_t i = 0; i < vertices.size(); ++i)
    anchors_.push_back({vertices[i], static_cast<float>(fit.weight(points[i]))});
}

ShadowKernels CarriedKernels::at(std::span<const glm::vec3> positions) const {
  PENUMBRA_ASSERT(positions.size() == positions_.size());
  if (std::ranges::equal(positions, positions_)) return first_;
  std::vector<Eigen::Vector3d> carried;
  carried.reserve(sites_.size());
  for (const Site& site : sites_) {
    Eigen::Vector3d position = site.position;
    for (const Anchor& anchor : std::span(anchors_).subspan(site.first, site.count)) {
      position += static_cast<double>(anchor.weight) *
                  (to_eigen(positions[anchor.vertex]) - to_eigen(positions_[anchor.vertex]));
    }
    carried.push_back(position);
  }
  ShadowKernels result;
  result.up = first_.up;
  result.radius = first_.radius;
  result.kernels.reserve(positions.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const Eigen::Vector3d& k = carried[site_of_[i]];
    result.kernels.push_back(is_float(k) ? glm::vec3(k.x(), k.y(), k.z()) : positions[i]);
  }
  return result;
}

ShadowKernels blended(const ShadowKernels& a, const ShadowKernels& b, double share) {
  PENUMBRA_ASSERT(a.kernels.size() == b.kernels.size() && share >= 0.0 && share <= 1.0);
  if (share == 0.0) return a;
  if (share == 1.0) return b;
  ShadowKernels result;
  result.up = a.up;
  result.kernels.reserve(a.kernels.size());
  const auto part = static_cast<float>(share);
  for (std::size_t i = 0; i < a.kernels.size(); ++i)
    result.kernels.push_back((1.0F - part) * a.kernels[i] + part * b.kernels[i]);
  if (a.radius.size() != a.kernels.size() || b.radius.size() != b.kernels.size()) return result;
  result.radius.reserve(a.radius.size());
  for (std::size_t i = 0; i < a.radius.size(); ++i)
    result.radius.push_back((1.0F - part) * a.radius[i] + part * b.radius[i]);
  return result;
}

}  // namespace penumbra
