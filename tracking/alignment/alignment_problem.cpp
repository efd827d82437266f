#include "tracking/alignment/alignment_problem.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <tuple>
#include <utility>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "tracking/math/se3.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

// Returns the variance of the wide stage's additional blur, which widens its convergence range.
double wide_variance_px2(double cell_px) {
  const double added_px = std::min(2.45, 0.25 * cell_px);
  return added_px * added_px;
}

// Returns the displacement per row [px] of a point `p` with the projection's derivative `J`.
Eigen::Vector2d shear_at(const Vector6d& row_velocity, const Eigen::Vector3d& p,
                         const Eigen::Matrix<double, 2, 3>& J) {
  // Points of the scene move opposite to the camera.
  const Eigen::Vector2d shear = -(J * (row_velocity.head<3>() + row_velocity.tail<3>().cross(p)));
  // Bounds the shear: a tag that moves as fast as the read-out is blurred, not sheared.
  constexpr double kMaxShear = 0.3;
  const double norm = shear.norm();
  if (!std::isfinite(norm)) return Eigen::Vector2d::Zero();
  return norm > kMaxShear ? Eigen::Vector2d(kMaxShear / norm * shear) : shear;
}

}  // namespace

std::array<float, 9> rows_of(const Eigen::Matrix3d& matrix) {
  std::array<float, 9> rows;
  Eigen::Map<Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>{rows.data()} = matrix.cast<float>();
  return rows;
}

Result<AlignmentProblem> AlignmentProblem::make(const CameraModel& camera,
                                                std::span<const MappedTag> tags,
                                                const AlignmentOptions& options) {
  AlignmentProblem problem;
  problem.camera = camera;
  problem.options = options;
  problem.loops = options.loops != nullptr ? options.loops : &simd::widest_loops();
  problem.lens = simd::lens_of(camera);
  problem.set_tone(camera.parameters().tone_curve.value_or(options.tone_exponent));
  for (const MappedTag& mapped : tags) {
    PENUMBRA_TRY(AlignedTag tag, AlignedTag::make(mapped));
    problem.tags.push_back(std::move(tag));
  }
  return problem;
}

void AlignmentProblem::set_tone(double exponent) {
  options.tone_exponent = exponent;
  for (int i = 0; i < 256; ++i)
    tone[static_cast<std::size_t>(i)] = static_cast<float>(255.0 * std::pow(i / 255.0, exponent));
}

void AlignmentProblem::begin(const AlignmentInput& input) {
  PENUMBRA_ASSERT(input.luma.width == camera.width() && input.luma.height == camera.height() &&
                  !input.luma.empty());
  // Memory offsets of pixels have 32 bits.
  PENUMBRA_ASSERT(std::abs(input.luma.stride) * input.luma.height < std::ptrdiff_t{1} << 31);
  PENUMBRA_ASSERT(input.predicted.is_finite() && input.covariance.allFinite());
  PENUMBRA_ASSERT(input.velocity.allFinite() && input.exposure_motion.allFinite());
  counters = {};
  for (AlignedTag& tag : tags) tag.rejected = false;
  for (const int index : input.rejected) tags[static_cast<std::size_t>(index)].rejected = true;
  image = input.luma;
  const MapFromCamera& predicted = input.predicted;
  T_predicted.linear() = predicted.rotation().conjugate().toRotationMatrix();
  T_predicted.translation() = -(T_predicted.linear() * predicted.translation());
  // A right perturbation xi of T_map_camera is a left one -xi of T_camera_map.
  prior_covariance = input.covariance;
  prior_information = inverse_of_spd(prior_covariance);
  PENUMBRA_ASSERT(prior_information.allFinite());
  row_s = camera.parameters().rolling_shutter_row_s.value_or(0.0);
  row_velocity = row_s * input.velocity;
  set_motion_prior(input);
  set_exposure_motion(input.exposure_motion);
}

void AlignmentProblem::set_motion_prior(const AlignmentInput& input) {
  motion_prior.reset();
  if (!(row_s > 0.0) || !input.velocity_prior) return;
  const VelocityPrior& velocity = *input.velocity_prior;
  PENUMBRA_ASSERT(velocity.covariance.allFinite() && velocity.cross_covariance.allFinite());
  // Right perturbations of T_map_camera have the same covariance as left ones of T_camera_map.
  Matrix12d covariance;
  covariance << input.covariance, velocity.cross_covariance.transpose(), velocity.cross_covariance,
      velocity.covariance;
  Eigen::LLT<Matrix12d> factors(covariance);
  MotionPrior prior;
  prior.velocity = input.velocity;
  prior.information = factors.solve(Matrix12d::Identity());
  if (factors.info() != Eigen::Success || !prior.information.allFinite()) {
    // Rounding made the correlation exceed 1.
    prior.information.setZero();
    prior.information.topLeftCorner<6, 6>() = prior_information;
    const Eigen::LLT<Matrix6d> of_velocity(velocity.covariance);
    constexpr double kMinVariance = 1e-9;
    const Vector6d variances = velocity.covariance.diagonal().cwiseMax(kMinVariance);
    prior.information.bottomRightCorner<6, 6>() =
        of_velocity.info() == Eigen::Success ? inverse_of_spd(velocity.covariance)
                                             : Matrix6d(variances.cwiseInverse().asDiagonal());
  }
  PENUMBRA_ASSERT(prior.information.allFinite());
  motion_prior = prior;
}

void AlignmentProblem::reset_motion() {
  T_camera_map = T_predicted;
  if (motion_prior) row_velocity = row_s * motion_prior->velocity;
}

void AlignmentProblem::set_exposure_motion(const Vector6d& motion) {
  exposure_motion = motion;
  if (motion.isZero(0.0)) return;
  for (auto& path : paths_) path.clear();
}

MapFromCamera AlignmentProblem::pose() const {
  const Eigen::Isometry3d T_map_camera = T_camera_map.inverse();
  return {Eigen::Matrix3d(T_map_camera.linear()), T_map_camera.translation()};
}

double AlignmentProblem::smallest_cell_px() const {
  double smallest = 1e9;
  for (const AlignedTag* tag : active) smallest = std::min(smallest, tag->cell_px);
  return smallest;
}

void AlignmentProblem::place(AlignedTag& tag) const {
  Eigen::Isometry3d T = T_camera_map * tag.T_map_tag;
  if (!row_velocity.isZero()) T = tag.row_motion * T;
  const double half = 0.5 * (tag.side - 1);
  const Eigen::Matrix3d R = T.linear();
  tag.ray_from_lattice.col(0) = R.col(0) * tag.cell_m;
  tag.ray_from_lattice.col(1) = R.col(1) * tag.cell_m;
  tag.ray_from_lattice.col(2) = T.translation() - half * tag.cell_m * (R.col(0) + R.col(1));
  tag.R_lattice_camera = R.transpose();
  tag.centre = -(R.transpose() * T.translation()) / tag.cell_m + Eigen::Vector3d(half, half, 0.0);
  tag.lattice_from_ray = rows_of(tag.ray_from_lattice.inverse() * tag.cell_m);  // homogeneous
}

void AlignmentProblem::set_row_motion(AlignedTag& tag) const {
  tag.row_motion = exp_se3(-(tag.row - 0.5 * (camera.height() - 1)) * row_velocity);
}

void AlignmentProblem::find_motion_by_velocity(AlignedTag& tag) const {
  using Jacobian = Eigen::Matrix<double, 2, 6>;
  const auto jacobian_at = [&](const Eigen::Vector3d& p, Eigen::Vector2d& pixel) {
    Eigen::Matrix<double, 2, 3> J;
    pixel = camera.project_unchecked(p, &J);
    Jacobian by_motion;
    by_motion << J, -J * skew(p);
    return by_motion;
  };
  tag.motion_by_velocity = read_time_s(tag) * Matrix6d::Identity();
  const double last = tag.side - 1;
  Eigen::Vector2d centre;
  const Jacobian of_centre = jacobian_at(tag.centre_point(), centre);
  Matrix6d normal = Matrix6d::Zero();
  Matrix6d shear = Matrix6d::Zero();
  for (const auto& [a, b] :
       {std::pair(0.0, 0.0), std::pair(last, 0.0), std::pair(0.0, last), std::pair(last, last)}) {
    const Eigen::Vector3d corner = tag.point(a, b);
    if (!(corner.z() > 0.0)) return;
    Eigen::Vector2d pixel;
    const Jacobian of_corner = jacobian_at(corner, pixel);
    normal += of_corner.transpose() * of_corner;
    shear += row_s * (pixel.y() - tag.row) * of_corner.transpose() * of_centre;
  }
  // Tilts of a tag that faces the camera are hardly visible; keeps them from becoming large.
  normal.diagonal() *= 1.0 + 1e-6;
  const Matrix6d by_shear = normal.ldlt().solve(shear);
  if (by_shear.allFinite()) tag.motion_by_velocity += by_shear;
}

Eigen::Vector2d AlignmentProblem::shear_of(const AlignedTag& tag) const {
  const Eigen::Vector3d p = tag.centre_point();
  if (!(p.z() > 0.0)) return Eigen::Vector2d::Zero();
  Eigen::Matrix<double, 2, 3> J;
  std::ignore = camera.project_unchecked(p, &J);
  return shear_at(row_velocity, p, J);
}

// Finds the row of the tag's centre, and the camera motion until a rolling shutter reads it.
void AlignmentProblem::find_row_motion(AlignedTag& tag) const {
  tag.row_motion.setIdentity();
  tag.row_shear.setZero();
  if (row_velocity.isZero() && !motion_prior) return;
  place(tag);
  // The second pass starts at the row of the first pass, because the motion changes the row.
  for (int pass = 0; pass < 2; ++pass) {
    const Eigen::Vector3d p = tag.centre_point();
    if (!(p.z() > 0.0)) return;
    Eigen::Matrix<double, 2, 3> J;
    tag.row = std::clamp(camera.project_unchecked(p, &J).y(), 0.0, camera.height() - 1.0);
    tag.row_shear = shear_at(row_velocity, p, J);
    set_row_motion(tag);
    place(tag);
  }
}

// Projects the lattice points of `vertices`, and displaces them by the rolling shutter.
void AlignmentProblem::project(AlignedTag& tag, double added_variance_px2,
                               simd::Vertices& vertices) const {
  const std::array<float, 9> M = rows_of(tag.ray_from_lattice);
  simd::Blur blur;
  blur.variance_px2 = static_cast<float>(options.blur_px * options.blur_px + added_variance_px2);
  blur.motion_x_px = static_cast<float>(tag.spread_px.x());
  blur.motion_y_px = static_cast<float>(tag.spread_px.y());
  loops->project(lens, blur, M.data(), tag.lattice_from_ray.data(), vertices);
  if (tag.row_shear.isZero()) return;
  // The vertex is read at the row r with r = y + shear_y (r - tag's row).
  const auto row = static_cast<float>(tag.row);
  const Eigen::Vector2f shear = (tag.row_shear / (1.0 - tag.row_shear.y())).cast<float>();
  for (int k = 0; k < vertices.count; ++k) {
    const float rows = vertices.pixel_y[k] - row;
    vertices.pixel_x[k] += shear.x() * rows;
    vertices.pixel_y[k] += shear.y() * rows;
  }
}

void AlignmentProblem::project_search(AlignedTag& tag) const {
  simd::Vertices points = {.count = static_cast<int>(tag.search_a.size()),
                           .a = tag.search_a.data(),
                           .b = tag.search_b.data(),
                           .pixel_x = tag.search_x.data(),
                           .pixel_y = tag.search_y.data(),
                           .depth = tag.search_depth.data()};
  project(tag, 0.0, points);
}

void AlignmentProblem::project_lattice(AlignedTag& tag, double added_variance_px2) const {
  simd::Vertices vertices = {.count = static_cast<int>(tag.lattice_a.size()),
                             .a = tag.lattice_a.data(),
                             .b = tag.lattice_b.data(),
                             .ray_x = tag.ray_x.data(),
                             .ray_y = tag.ray_y.data(),
                             .pixel_x = tag.pixel_x.data(),
                             .pixel_y = tag.pixel_y.data(),
                             .depth = tag.depth.data(),
                             .ka = tag.ka.data(),
                             .kb = tag.kb.data(),
                             .rho = tag.correlated ? tag.rho.data() : nullptr};
  project(tag, added_variance_px2, vertices);
  // Depth is linear in the lattice and the lens model's disc is convex, so the corners suffice.
  const auto last = static_cast<std::size_t>(tag.side - 1);
  const auto top = last * static_cast<std::size_t>(tag.side);
  tag.fully_projected = tag.depth[0] > 0.0F && tag.depth[last] > 0.0F && tag.depth[top] > 0.0F &&
                        tag.depth[top + last] > 0.0F;
}

const std::int32_t* AlignmentProblem::find_cell_pixels(const AlignedTag& tag) {
  cell_pixels_.resize(std::max(cell_pixels_.size(), tag.lattice_a.size()));
  loops->cell_pixels(tag.side, {tag.pixel_x.data(), tag.pixel_y.data(), tag.depth.data()},
                     {image.width, image.height, image.stride}, cell_pixels_.data());
  return cell_pixels_.data();
}

// Computes the tag's image motion during the exposure, and chooses the number of moments.
void AlignmentProblem::measure_motion(AlignedTag& tag, const Eigen::Vector3d& centre,
                                      const Eigen::Matrix<double, 2, 3>& J, BlurModel blur) const {
  tag.motion_px.setZero();
  tag.spread_px.setZero();
  tag.moments = 1;
  if (exposure_motion.isZero(0.0)) return;
  // Points of the scene move opposite to the camera.
  const auto motion_of = [&](const Eigen::Vector3d& p) -> Eigen::Vector2d {
    return -(J * (exposure_motion.head<3>() + exposure_motion.tail<3>().cross(p))) *
           (centre.z() / p.z());
  };
  tag.motion_px = motion_of(centre);
  double longest_px = tag.motion_px.norm();
  const double last = tag.side - 1;
  for (const auto& [a, b] :
       {std::pair(0.0, 0.0), std::pair(last, 0.0), std::pair(0.0, last), std::pair(last, last)}) {
    const Eigen::Vector3d corner = tag.point(a, b);
    if (corner.z() > 0.0) longest_px = std::max(longest_px, motion_of(corner).norm());
  }
  // Distance between moments [sigmas]: their sum differs from a uniform blur by 1/300 of the gain.
  constexpr double kSigmasApart = 4.0;
  if (blur == BlurModel::moments)
    tag.moments = std::clamp(ceil_of(std::min(longest_px / (kSigmasApart * options.blur_px), 1e5)),
                             1, kMaxMoments);
  tag.spread_px = tag.motion_px / tag.moments;
}

void AlignmentProblem::place_moments(AlignedTag& tag) {
  std::vector<Eigen::Isometry3d>& path = paths_[static_cast<std::size_t>(tag.moments)];
  if (path.empty()) {
    // A right perturbation xi of T_map_camera is a left one -xi of T_camera_map.
    for (int k = 0; k < tag.moments; ++k)
      path.push_back(exp_se3(-((k + 0.5) / tag.moments - 0.5) * exposure_motion));
  }
  tag.moment_samples.resize(path.size());
  tag.moment_inputs.resize(path.size());
  for (std::size_t k = 0; k < path.size(); ++k) {
    Eigen::Matrix3d M = path[k].linear() * tag.ray_from_lattice;
    M.col(2) += path[k].translation();
    std::ranges::copy(rows_of(M.inverse() * tag.cell_m), tag.moment_inputs[k].lattice_from_ray);
  }
}

bool AlignmentProblem::measure(AlignedTag& tag, BlurModel blur) const {
  tag.too_small = false;
  if (!(tag.centre.z() > 0.5)) return false;  // the camera is behind the sheet or in its plane
  const double half = 0.5 * (tag.side - 1);
  const Eigen::Vector3d p = tag.ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
  if (!(p.z() > 0.0)) return false;
  if (p.head<2>().norm() >= camera.max_radius() * p.z()) return false;
  Eigen::Matrix<double, 2, 3> J;
  const Eigen::Vector2d pixel = camera.project_unchecked(p, &J);
  const Eigen::Vector2d along_a = J * tag.ray_from_lattice.col(0);
  const Eigen::Vector2d along_b = J * tag.ray_from_lattice.col(1);
  tag.along_a = along_a;
  tag.along_b = along_b;
  const double area = std::abs(along_a.x() * along_b.y() - along_a.y() * along_b.x());
  const double across_a = area / along_b.norm();  // distance between two a-lines
  const double across_b = area / along_a.norm();
  tag.cell_px = std::min(across_a, across_b);
  tag.cell_max_px = std::max(across_a, across_b);
  if (!(tag.cell_px >= options.min_cell_px)) {
    tag.too_small = true;
    return false;
  }
  constexpr double kMaxCell_px = 1e5;  // larger than any image; counts of pixels fit integers
  if (!(tag.cell_max_px <= kMaxCell_px)) return false;
  const double radius_px = half * (along_a.norm() + along_b.norm());
  if (!(pixel.x() > -radius_px && pixel.y() > -radius_px &&
        pixel.x() < camera.width() + radius_px && pixel.y() < camera.height() + radius_px))
    return false;
  measure_motion(tag, p, J, blur);
  const double variance_px = options.blur_px * options.blur_px;
  const Eigen::Matrix2d cov =
      variance_px * Eigen::Matrix2d::Identity() + tag.spread_px * tag.spread_px.transpose() / 12.0;
  Eigen::Matrix2d basis;
  basis << along_a, along_b;
  const Eigen::Matrix2d G = basis.inverse();
  const Eigen::Matrix2d cov_lattice = G * cov * G.transpose();
  tag.correlation = cov_lattice(0, 1) / std::sqrt(cov_lattice(0, 0) * cov_lattice(1, 1));
  // A line affects pixels within 2.5 sigma; the nearest ignored line is reach / 2 cells away.
  const double sigma_cells = std::sqrt(std::max(cov_lattice(0, 0), cov_lattice(1, 1)));
  if (tag.moments > 1) tag.sigma_cells = cov_lattice.diagonal().cwiseSqrt();
  tag.reach = sigma_cells < 0.2 ? 1 : (sigma_cells < 0.4 ? 2 : 3);
  // The correlation changes only pixels at vertices, and little the mean of many moments.
  constexpr int kMaxCorrelatedMoments = 2;
  tag.correlated = tag.moments <= kMaxCorrelatedMoments && std::abs(tag.correlation) > 0.3;
  return true;
}

void AlignmentProblem::find_visible(Projection projection) {
  active.clear();
  counters.tags_out_of_view = 0;
  counters.tags_too_small = 0;
  moved_since_projection_px = 0.0;
  for (AlignedTag& tag : tags) {
    if (tag.rejected) continue;
    find_row_motion(tag);
    place(tag);
    tag.visible = measure(tag);
    if (!tag.visible) {
      ++(tag.too_small ? counters.tags_too_small : counters.tags_out_of_view);
      continue;
    }
    if (projection == Projection::search) {
      project_search(tag);
    } else if (projection == Projection::wide) {
      tag.correlated = false;  // negligible with the additional blur
      project_lattice(tag, wide_variance_px2(tag.cell_px));
    } else {
      project_lattice(tag, 0.0);
    }
    active.push_back(&tag);
  }
}

}  // namespace penumbra
