#include "calib/survey/tag_graph.hpp"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <set>

#include "calib/solver/bundle.hpp"
#include "calib/solver/stop_callback.hpp"
#include "calib/target/target_edges.hpp"
#include "core/statistics.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {
namespace {

constexpr double kMinDepth_m = 1e-6;      // minimum depth of a point in the camera frame [m]
constexpr double kGraphShiftPrior = 0.5;  // sigma of the edge shift [px]
constexpr double kDetectionNoise = 0.1;   // sigma of a coordinate of a detected corner [px]
constexpr double kMeasuredFloor = 0.01;   // sigma of lens model errors [px]
// Errors of a tag's corners that are the same in all frames (docs/calibration.md#survey).
constexpr double kCommonError = 0.02;     // minimum [px]
constexpr double kCommonShare = 0.3;      // as a fraction of the corners' RMS 2-D error
constexpr std::size_t kMinFrames = 2;     // minimum number of frames that show a tag
constexpr std::size_t kMaxClusters = 20;  // maximum number of clusters of neighbouring frames
constexpr int kTagSize = 6;

// Whitened residuals of a tag's four corners in one frame.
struct SightingCost {
  const TagSighting* sighting;
  DistortionModel model;

  // Parameters: T_camera_anchor, T_anchor_tag, edge shift, lens.
  template <class T>
  bool operator()(const T* camera_pose, const T* tag_pose, const T* shift, const T* lens,
                  T* residual) const {
    return evaluate(camera_pose, tag_pose, T(1.0), shift, lens, residual);
  }

  // `scale`: true / nominal size of the tag.
  template <class T>
  bool evaluate(const T* camera_pose, const T* tag_pose, const T& scale, const T* shift,
                const T* lens, T* residual) const {
    std::array<T, 8> k;
    std::copy(lens + 4, lens + kLensSize, k.begin());
    const auto corners = tag_corners(sighting->size_m);
    std::array<T, 8> errors;
    for (std::size_t i = 0; i < 4; ++i) {
      const T p[3] = {scale * corners[i].x(), scale * corners[i].y(), T(0.0)};
      T at[3];
      ceres::AngleAxisRotatePoint(tag_pose, p, at);
      for (int j = 0; j < 3; ++j) at[j] += tag_pose[3 + j];
      T in_camera[3];
      ceres::AngleAxisRotatePoint(camera_pose, at, in_camera);
      for (int j = 0; j < 3; ++j) in_camera[j] += camera_pose[3 + j];
      if (!(in_camera[2] > T(kMinDepth_m))) return false;
      T x_d;
      T y_d;
      distort<T>(model, k, in_camera[0] / in_camera[2], in_camera[1] / in_camera[2], x_d, y_d);
      const Eigen::Vector2d& pixel = sighting->corners_px[i];
      const Eigen::Vector2d& spread = sighting->spread[i];
      errors[2 * i] = lens[0] * x_d + lens[2] + shift[0] * spread.x() - pixel.x();
      errors[2 * i + 1] = lens[1] * y_d + lens[3] + shift[0] * spread.y() - pixel.y();
    }
    for (int i = 0; i < 8; ++i) {
      residual[i] = T(0.0);
      for (int j = 0; j <= i; ++j)
        residual[i] += sighting->whitening(i, j) * errors[static_cast<std::size_t>(j)];
    }
    return true;
  }
};
using SightingFunction =
    ceres::AutoDiffCostFunction<SightingCost, 8, kTagSize, kTagSize, 1, kLensSize>;

// Like SightingCost, with fixed camera and lens and a free tag size.
struct SizedSightingCost {
  SightingCost cost;
  Pose6 camera_pose;
  double shift;
  LensParameters lens;

  // Parameters: T_anchor_tag, logarithm of (true / nominal size).
  template <class T>
  bool operator()(const T* tag_pose, const T* log_scale, T* residual) const {
    std::array<T, 6> camera;
    std::array<T, kLensSize> with;
    const auto constant = [](double x) { return T(x); };
    std::transform(camera_pose.begin(), camera_pose.end(), camera.begin(), constant);
    std::transform(lens.begin(), lens.end(), with.begin(), constant);
    const T moved(shift);
    using std::exp;
    return cost.evaluate(camera.data(), tag_pose, T(exp(log_scale[0])), &moved, with.data(),
                         residual);
  }
};
using SizedSightingFunction = ceres::AutoDiffCostFunction<SizedSightingCost, 8, kTagSize, 1>;

struct ShiftPrior {
  template <class T>
  bool operator()(const T* shift, T* residual) const {
    residual[0] = shift[0] / kGraphShiftPrior;
    return true;
  }
};

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

TagSighting sighting_of(int id, double size_m, const std::array<Eigen::Vector2d, 4>& corners_px) {
  TagSighting sighting{id, size_m, corners_px, edge_spreads(corners_px), {}};
  sighting.whitening = Matrix8d::Identity() / kDetectionNoise;
  return sighting;
}

TagSighting sighting_of(int id, double size_m, const MeasuredTag& measured) {
  TagSighting sighting{id, size_m, measured.corners_px, {}, {}};
  sighting.spread.fill(Eigen::Vector2d::Zero());
  const Matrix8d covariance =
      measured.covariance + kMeasuredFloor * kMeasuredFloor * Matrix8d::Identity();
  const Eigen::LLT<Matrix8d> factor(covariance);
  sighting.whitening = factor.matrixL().solve(Matrix8d::Identity());
  return sighting;
}

TagGraph::TagGraph(const CameraModel& camera, int anchor)
    : start_(camera), anchor_(anchor), lens_(lens_of(camera.parameters())) {}

double TagPlacement::mean_px() const {
  double sum = 0.0;
  for (const auto& [frame, error] : errors_px) sum += std::min(error, kMaxSightingError_px);
  return errors_px.empty() ? 0.0 : sum / static_cast<double>(errors_px.size());
}

double TagPlacement::median_px() const {
  std::vector<double> errors;
  for (const auto& [frame, error] : errors_px) errors.push_back(error);
  return upper_median(std::move(errors));
}

Result<CameraModel> TagGraph::camera() const {
  if (!lens_is_free) return start_;
  CameraParameters p = start_.parameters();
  set_lens(p, lens_);
  p.overlay_sigma_px.reset();  // valid only for the given lens
  return CameraModel::make(p);
}

std::vector<PointObservation> TagGraph::placed_in(std::size_t frame) const {
  std::vector<PointObservation> points;
  for (const TagSighting& sighting : frames[frame]) {
    const auto placed = tags.find(sighting.id);
    if (placed == tags.end()) continue;
    const auto T_anchor_tag = unpacked<frame::Table, frame::Tag>(placed->second);
    const auto corners = tag_corners(sighting.size_m);
    for (std::size_t i = 0; i < 4; ++i)
      points.push_back({T_anchor_tag * corners[i], sighting.corners_px[i]});
  }
  return points;
}

void TagGraph::pose_cameras() {
  cameras.resize(frames.size());
  const Result<CameraModel> lens = this->camera();
  if (!lens) return;
  const CameraModel& camera = *lens;
  for (std::size_t f = 0; f < frames.size() && !stop.stop_requested(); ++f) {
    const auto points = placed_in(f);
    if (points.size() < 4) continue;
    std::optional<RefinedPose> best;
    double second = std::numeric_limits<double>::infinity();
    for (const MapFromCamera& start : solve_pose(camera, points)) {
      const auto refined = refine_pose(camera, points, start);
      if (!refined) continue;
      const bool other =
          best && perturbation_between(best->T_map_camera, refined->T_map_camera).norm() > 1e-3;
      if (!best || refined->rms_px < best->rms_px) {
        if (other) second = best->rms_px;
        best = refined;
      } else if (other) {
        second = std::min(second, refined->rms_px);
      }
    }
    if (!best || best->rms_px > 5.0) continue;
    if (points.size() == 4 && second < 2.0 * best->rms_px + 0.1) continue;
    cameras[f] = packed(as_table_pose(best->T_map_camera).inverse());
  }
}

std::vector<TagGraph::PosedSighting> TagGraph::sightings_of(int id, std::size_t first,
                                                            std::size_t last) const {
  std::vector<PosedSighting> seen;
  for (std::size_t f = first; f < std::min(last, frames.size()); ++f) {
    if (f >= cameras.size() || !cameras[f]) continue;
    for (const TagSighting& sighting : frames[f]) {
      if (sighting.id == id) seen.emplace_back(f, &sighting);
    }
  }
  return seen;
}

void TagGraph::measure(TagPlacement& fit, const std::vector<PosedSighting>& seen,
                       const CameraModel& camera) const {
  fit.errors_px.clear();
  for (const auto& [frame, sighting] : seen) {
    const auto T = unpacked<frame::Camera, frame::Table>(*cameras[frame]) * fit.T_anchor_tag;
    const auto corners = tag_corners(fit.scale * sighting->size_m);
    double sum = 0.0;
    for (std::size_t i = 0; i < 4; ++i) {
      const auto pixel = camera.project(T * corners[i]);
      sum += pixel ? (*pixel + shift * sighting->spread[i] - sighting->corners_px[i]).squaredNorm()
                   : 1e6;
    }
    fit.errors_px.emplace_back(frame, std::sqrt(0.25 * sum));
  }
}

void TagGraph::measure(TagPlacement& fit, int id) const {
  if (const Result<CameraModel> lens = this->camera()) measure(fit, sightings_of(id), *lens);
}

std::optional<TagPlacement> TagGraph::place(int id, double scale, std::size_t first,
                                            std::size_t last) const {
  const Result<CameraModel> lens = this->camera();
  if (!lens) return std::nullopt;
  const CameraModel& camera = *lens;
  const std::vector<PosedSighting> seen = sightings_of(id, first, last);
  if (seen.size() < kMinFrames) return std::nullopt;
  const auto corners = tag_corners(scale * seen.front().second->size_m);
  std::optional<TagPlacement> best;
  double min_error_px = std::numeric_limits<double>::infinity();
  const std::size_t step = std::max<std::size_t>(1, seen.size() / 10);
  for (std::size_t k = 0; k < seen.size() && !stop.stop_requested(); k += step) {
    const auto& [frame, sighting] = seen[k];
    std::vector<PointObservation> points;  // in the tag frame
    for (std::size_t i = 0; i < 4; ++i) points.push_back({corners[i], sighting->corners_px[i]});
    for (const MapFromCamera& T_tag_camera : solve_pose(camera, points)) {
      const auto T_camera_anchor = unpacked<frame::Camera, frame::Table>(*cameras[frame]);
      const Transform<frame::Camera, frame::Tag> T_camera_tag(T_tag_camera.inverse().rotation(),
                                                              T_tag_camera.inverse().translation());
      TagPlacement here;
      here.T_anchor_tag = T_camera_anchor.inverse() * T_camera_tag;
      here.scale = scale;
      measure(here, seen, camera);
      const double median = here.median_px();
      if (median < min_error_px) {
        min_error_px = median;
        best = std::move(here);
      }
    }
  }
  return best;
}

std::optional<TagPlacement> TagGraph::fit(int id, bool free_size, std::size_t first,
                                          std::size_t last) const {
  const Result<CameraModel> lens = this->camera();
  if (!lens) return std::nullopt;
  // The tag's distance depends on its size, so try sizes from 1/6 to 6 times the nominal one.
  constexpr double kStep = 1.12;
  constexpr int kSteps = 16;
  std::optional<TagPlacement> best;
  for (int k = free_size ? -kSteps : 0; k <= (free_size ? kSteps : 0); ++k) {
    auto here = place(id, std::pow(kStep, k), first, last);
    if (here && (!best || here->mean_px() < best->mean_px())) best = std::move(here);
  }
  if (!best) return std::nullopt;
  const std::vector<PosedSighting> seen = sightings_of(id, first, last);
  Pose6 pose = packed(best->T_anchor_tag);
  double log_scale = std::log(best->scale);
  ceres::Problem problem;
  for (const auto& [frame, sighting] : seen) {
    problem.AddResidualBlock(
        new SizedSightingFunction(new SizedSightingCost{
            {sighting, start_.parameters().model}, *cameras[frame], shift, lens_}),
        new ceres::CauchyLoss(10.0), pose.data(), &log_scale);
  }
  if (!free_size) problem.SetParameterBlockConstant(&log_scale);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return best;
  TagPlacement fitted;
  fitted.T_anchor_tag = unpacked<frame::Table, frame::Tag>(pose);
  fitted.scale = std::exp(log_scale);
  measure(fitted, seen, *lens);
  return fitted.mean_px() < best->mean_px() ? fitted : best;
}

template <class Visit>
void TagGraph::for_each(const Visit& visit) {
  for (std::size_t f = 0; f < frames.size(); ++f) {
    if (!cameras[f]) continue;
    for (const TagSighting& sighting : frames[f]) {
      const auto placed = tags.find(sighting.id);
      if (placed != tags.end()) visit(f, sighting, placed->second);
    }
  }
}

void TagGraph::build(ceres::Problem& problem, bool robust) {
  const DistortionModel model = start_.parameters().model;
  for_each([&](std::size_t f, const TagSighting& sighting, Pose6& tag) {
    problem.AddResidualBlock(new SightingFunction(new SightingCost{&sighting, model}),
                             robust ? new ceres::CauchyLoss(10.0) : nullptr, cameras[f]->data(),
                             tag.data(), &shift, lens_.data());
  });
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<ShiftPrior, 1, 1>(new ShiftPrior),
                           nullptr, &shift);
  if (!shift_is_free) problem.SetParameterBlockConstant(&shift);
  if (problem.HasParameterBlock(lens_.data())) {
    const int used = 4 + coefficient_count(model);
    if (!lens_is_free) {
      problem.SetParameterBlockConstant(lens_.data());
    } else if (used < kLensSize) {
      std::vector<int> unused;
      for (int i = used; i < kLensSize; ++i) unused.push_back(i);
      problem.SetManifold(lens_.data(), new ceres::SubsetManifold(kLensSize, unused));
    }
  }
  Pose6& anchor = tags.at(anchor_);
  if (problem.HasParameterBlock(anchor.data())) problem.SetParameterBlockConstant(anchor.data());
}

bool TagGraph::adjust(bool robust) {
  ceres::Problem problem;
  build(problem, robust);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 60;
  options.num_threads = 1;  // for reproducible sums
  options.logging_type = ceres::SILENT;
  StopCallback ends(stop);
  options.callbacks.push_back(&ends);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.IsSolutionUsable();
}

bool TagGraph::drop_outliers(double& rms_px) {
  const DistortionModel model = start_.parameters().model;
  std::vector<std::pair<std::pair<std::size_t, int>, double>> all;  // frame and tag; whitened RMS
  std::map<std::pair<std::size_t, int>, double> squares_px;
  for_each([&](std::size_t f, const TagSighting& sighting, const Pose6& tag) {
    Eigen::Matrix<double, 8, 1> r;
    const SightingCost cost{&sighting, model};
    if (!cost(cameras[f]->data(), tag.data(), &shift, lens_.data(), r.data())) r.setConstant(1e6);
    all.push_back({{f, sighting.id}, std::sqrt(r.squaredNorm() / 8.0)});
    const Eigen::Matrix<double, 8, 1> px =
        sighting.whitening.triangularView<Eigen::Lower>().solve(r);
    squares_px[{f, sighting.id}] = px.squaredNorm();
  });
  if (all.empty()) return false;
  std::vector<double> sizes;
  for (const auto& [key, size] : all) sizes.push_back(size);
  // A lens error can displace a whole tag by several sigma of its edges: reject only far outliers.
  const double limit = std::max(6.0 * upper_median(std::move(sizes)), 3.0);
  std::set<std::pair<std::size_t, int>> bad;
  double sum = 0.0;
  int corners = 0;
  for (const auto& [key, size] : all) {
    if (size > limit) {
      bad.insert(key);
      continue;
    }
    sum += squares_px[key];
    corners += 4;
  }
  rms_px = std::sqrt(sum / std::max(corners, 1));
  for (std::size_t f = 0; f < frames.size(); ++f) {
    std::erase_if(frames[f], [&](const TagSighting& s) { return bad.count({f, s.id}) > 0; });
  }
  return !bad.empty();
}

Result<GraphCovariance> TagGraph::covariance() {
  const DistortionModel model = start_.parameters().model;
  const int n_lens = lens_is_free ? 4 + coefficient_count(model) : 0;
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
  result.lens = covariance.topLeftCorner(n_lens, n_lens);
  result.tags = covariance.bottomRightCorner(n - n_lens - 1, n - n_lens - 1);
  return result;
}

}  // namespace penumbra
