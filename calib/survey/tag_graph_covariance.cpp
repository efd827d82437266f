// Covariance of the tags and the lens of a TagGraph.
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "calib/solver/bundle.hpp"
#include "calib/survey/sighting_cost.hpp"
#include "calib/survey/tag_graph.hpp"

namespace penumbra {
namespace {

// Errors of a tag's corners that are the same in all frames (docs/calibration.md#survey).
constexpr double kCommonError = 0.02;     // minimum [px]
constexpr double kCommonShare = 0.3;      // as a fraction of the corners' RMS 2-D error
constexpr std::size_t kMaxClusters = 20;  // maximum number of clusters of neighbouring frames

// Returns d (angle-axis, translation) / d [position; rotation about the anchor's axes].
Eigen::Matrix<double, 6, 6> tangent_of(const Pose6& pose) {
  Eigen::Matrix3d turn;  // d rotation / d angle-axis, by central differences
  for (int i = 0; i < 3; ++i) {
    Pose6 after = pose;
    Pose6 before = pose;
    after[static_cast<std::size_t>(i)] += 1e-6;
    before[static_cast<std::size_t>(i)] -= 1e-6;
    const Eigen::Quaterniond d = unpacked<frame::Table, frame::Tag>(after).rotation() *
                                 unpacked<frame::Table, frame::Tag>(before).rotation().conjugate();
    turn.col(i) = (d.w() < 0.0 ? -1.0 : 1.0) * d.vec() / 1e-6;
  }
  Eigen::Matrix<double, 6, 6> J = Eigen::Matrix<double, 6, 6>::Zero();
  J.block<3, 3>(0, 3) = turn.inverse();
  J.block<3, 3>(3, 0).setIdentity();
  return J;
}

// Returns d corners [px] / d their displacements along the tag's edges [px].
Matrix8d edge_directions(const TagSighting& sighting) {
  const auto& c = sighting.corners_px;
  const Eigen::Vector2d a = (c[1] - c[0] + c[2] - c[3]).normalized();
  const Eigen::Vector2d b = (c[3] - c[0] + c[2] - c[1]).normalized();
  Matrix8d directions = Matrix8d::Zero();
  for (Eigen::Index i = 0; i < 4; ++i) {
    directions.block<2, 1>(2 * i, 2 * i) = a;
    directions.block<2, 1>(2 * i, 2 * i + 1) = b;
  }
  return directions;
}

// Derivatives of the gradients of unknowns and camera by a tag's corners along its edges.
struct SeenTag {
  int id = 0;
  Eigen::MatrixXd unknowns;
  Eigen::MatrixXd camera;
};

}  // namespace

Result<GraphCovariance> TagGraph::covariance() const {
  const DistortionModel model = start_.parameters().model;
  const Eigen::Index n_lens = lens_prior.rows();
  GraphCovariance result;
  std::map<int, Eigen::Index> first;  // first row of each tag
  std::map<int, Eigen::Matrix<double, 6, 6>> tangents;
  for (const auto& [id, pose] : tags) {
    if (id == anchor_) continue;
    first[id] = n_lens + 1 + kTagSize * static_cast<Eigen::Index>(result.ids.size());
    tangents[id] = tangent_of(pose);
    result.ids.push_back(id);
  }
  // Unknowns: lens, shift, tags. Cameras are marginalised frame by frame.
  const Eigen::Index n = n_lens + 1 + kTagSize * static_cast<Eigen::Index>(result.ids.size());
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(n, n);
  S(n_lens, n_lens) = 1.0 / (kGraphShiftPrior * kGraphShiftPrior);
  if (n_lens > 0) {
    S.topLeftCorner(n_lens, n_lens) =
        prior_noise * prior_noise *
        lens_prior.llt().solve(Eigen::MatrixXd::Identity(n_lens, n_lens));
  }
  std::vector<Eigen::VectorXd> scores;  // per frame: gradients with marginalised camera
  // Per tag: d gradient / d common errors (equal in all frames) of its corners along its edges.
  std::map<int, Eigen::MatrixXd> common;
  double sum = 0.0;
  double squares_px = 0.0;
  double corners = 0.0;
  double dof = static_cast<double>(-n);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    if (!cameras[f]) continue;
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, n);
    Eigen::MatrixXd B = Eigen::MatrixXd::Zero(n, kTagSize);
    Eigen::Matrix<double, 6, 6> C = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::VectorXd g = Eigen::VectorXd::Zero(n);
    Eigen::Matrix<double, 6, 1> h = Eigen::Matrix<double, 6, 1>::Zero();
    std::vector<SeenTag> seen;
    for (const TagSighting& sighting : frames[f]) {
      const auto placed = tags.find(sighting.id);
      if (placed == tags.end()) continue;
      const SightingFunction cost(new SightingCost{&sighting, model});
      Eigen::Matrix<double, 8, 1> r;
      Eigen::Matrix<double, 8, 6, Eigen::RowMajor> J_camera;
      Eigen::Matrix<double, 8, 6, Eigen::RowMajor> J_tag;
      Eigen::Matrix<double, 8, 1> J_shift;
      Eigen::Matrix<double, 8, kLensSize, Eigen::RowMajor> J_lens;
      const std::array<const double*, 4> at = {cameras[f]->data(), placed->second.data(), &shift,
                                               lens_.data()};
      std::array<double*, 4> jacobians = {J_camera.data(), J_tag.data(), J_shift.data(),
                                          J_lens.data()};
      if (!cost.Evaluate(at.data(), r.data(), jacobians.data()))
        return fail("a tag ended up behind the camera; sweep slower, over several tags at a time");
      Eigen::MatrixXd J = Eigen::MatrixXd::Zero(8, n);
      J.leftCols(n_lens) = J_lens.leftCols(n_lens);
      if (shift_is_free) J.col(n_lens) = J_shift;
      if (sighting.id != anchor_)
        J.middleCols(first.at(sighting.id), kTagSize) = J_tag * tangents.at(sighting.id);
      A += J.transpose() * J;
      B += J.transpose() * J_camera;
      C += J_camera.transpose() * J_camera;
      g += J.transpose() * r;
      h += J_camera.transpose() * r;
      sum += r.squaredNorm();
      squares_px += sighting.whitening.triangularView<Eigen::Lower>().solve(r).squaredNorm();
      corners += 4.0;
      const Matrix8d along_edges = sighting.whitening * edge_directions(sighting);
      seen.push_back(
          {sighting.id, J.transpose() * along_edges, J_camera.transpose() * along_edges});
    }
    if (seen.empty()) continue;
    dof += 8.0 * static_cast<double>(seen.size()) - 6.0;
    const Eigen::LDLT<Eigen::Matrix<double, 6, 6>> camera(C);
    const Eigen::MatrixXd BC = camera.solve(B.transpose()).transpose();
    S += A - BC * B.transpose();
    scores.emplace_back(g - BC * h);
    for (const SeenTag& tag : seen) {
      const Eigen::MatrixXd response = tag.unknowns - BC * tag.camera;
      const auto [at, added] = common.emplace(tag.id, response);
      if (!added) at->second += response;
    }
  }
  if (dof < 4.0) return fail("too few tags and frames to place them; sweep over all of them");
  const double noise = std::sqrt(sum / dof);
  // Scales the diagonal to 1, because the unknowns differ by orders of magnitude.
  const Eigen::VectorXd scale = S.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * S * scale.asDiagonal();
  const Eigen::LDLT<Eigen::MatrixXd> factor(scaled);
  Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(n, n));
  inverse = scale.asDiagonal() * inverse * scale.asDiagonal();
  if (factor.info() != Eigen::Success || !(factor.rcond() > 1e-13) || !inverse.allFinite() ||
      !(inverse.diagonal().minCoeff() > 0.0)) {
    return fail(
        "the positions of some tags are not determined; see every tag together with others, in "
        "several frames");
  }
  // Errors of neighbouring frames are correlated (light, blur, lens model). Covariance inflation:
  // scatter of the scores summed over clusters of frames, relative to that of independent errors.
  const std::size_t clusters = std::min(kMaxClusters, scores.size());
  std::vector<Eigen::VectorXd> cluster_scores(clusters, Eigen::VectorXd::Zero(n));
  for (std::size_t k = 0; k < scores.size(); ++k)
    cluster_scores[k * clusters / scores.size()] += scores[k];
  double scatter = 0.0;
  for (const Eigen::VectorXd& cluster : cluster_scores) scatter += cluster.dot(inverse * cluster);
  scatter *= static_cast<double>(clusters) / std::max(static_cast<double>(clusters) - 1.0, 1.0);
  const double ratio = scatter / (static_cast<double>(n) * noise * noise);
  result.covariance_inflation = std::isfinite(ratio) ? std::clamp(ratio, 1.0, 1000.0) : 1.0;
  Eigen::MatrixXd covariance = inverse * noise * noise * result.covariance_inflation;
  const double common_px = std::max(kCommonError, kCommonShare * std::sqrt(squares_px / corners));
  for (const auto& [id, response] : common) {
    const Eigen::MatrixXd moved = inverse * response * common_px;
    covariance += moved * moved.transpose();
  }
  if (n_lens > 0) {
    const double variance = noise * noise * result.covariance_inflation;
    const Eigen::ArrayXd independent = variance * inverse.diagonal().head(n_lens).array();
    const Eigen::ArrayXd total = covariance.diagonal().head(n_lens).array();
    result.lens_noise = std::sqrt(variance * (total / independent).mean());
    // The errors of the prior have the sigma `prior_noise` instead.
    const double prior_variance = prior_noise * prior_noise;
    covariance += prior_variance * (prior_variance - variance) * inverse.leftCols(n_lens) *
                  lens_prior.llt().solve(Eigen::MatrixXd(inverse.topRows(n_lens)));
  }
  result.lens = covariance.topLeftCorner(n_lens, n_lens);
  result.tags = covariance.bottomRightCorner(n - n_lens - 1, n - n_lens - 1);
  return result;
}

}  // namespace penumbra
