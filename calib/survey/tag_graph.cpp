#include "calib/survey/tag_graph.hpp"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <set>

#include "calib/solver/bundle.hpp"
#include "calib/solver/stop_callback.hpp"
#include "calib/survey/sighting_cost.hpp"
#include "calib/target/target_edges.hpp"
#include "core/statistics.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {
namespace {

constexpr double kDetectionNoise = 0.1;  // sigma of a coordinate of a detected corner [px]
constexpr double kMeasuredFloor = 0.01;  // sigma of lens model errors [px]
constexpr std::size_t kMinFrames = 2;    // minimum number of frames that show a tag

struct ShiftPrior {
  template <class T>
  bool operator()(const T* shift, T* residual) const {
    residual[0] = shift[0] / kGraphShiftPrior;
    return true;
  }
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
  if (lens_prior.size() == 0) return start_;
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
  if (problem.HasParameterBlock(lens_.data())) add_lens_prior(problem);
  Pose6& anchor = tags.at(anchor_);
  if (problem.HasParameterBlock(anchor.data())) problem.SetParameterBlockConstant(anchor.data());
}

void TagGraph::add_lens_prior(ceres::Problem& problem) {
  if (lens_prior.size() == 0) {
    problem.SetParameterBlockConstant(lens_.data());
    return;
  }
  const auto used = static_cast<int>(lens_prior.rows());
  Eigen::MatrixXd whitening = Eigen::MatrixXd::Zero(used, kLensSize);
  whitening.leftCols(used) =
      prior_noise * lens_prior.llt().matrixL().solve(Eigen::MatrixXd::Identity(used, used));
  const LensParameters given = lens_of(start_.parameters());
  const Eigen::Map<const Eigen::VectorXd> mean(given.data(), kLensSize);
  problem.AddResidualBlock(new ceres::NormalPrior(whitening, mean), nullptr, lens_.data());
  if (used == kLensSize) return;
  std::vector<int> unused;
  for (int i = used; i < kLensSize; ++i) unused.push_back(i);
  problem.SetManifold(lens_.data(), new ceres::SubsetManifold(kLensSize, unused));
}

std::optional<double> TagGraph::solve(ceres::Problem& problem) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 60;
  options.num_threads = 1;  // for reproducible sums
  options.logging_type = ceres::SILENT;
  StopCallback ends(stop);
  options.callbacks.push_back(&ends);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.IsSolutionUsable() ? std::optional(summary.final_cost) : std::nullopt;
}

bool TagGraph::adjust(bool robust) {
  ceres::Problem problem;
  build(problem, robust);
  return solve(problem).has_value();
}

std::optional<double> TagGraph::fit_cameras() {
  ceres::Problem problem;
  for_each([&](std::size_t f, const TagSighting& sighting, Pose6& tag) {
    problem.AddResidualBlock(
        new SightingFunction(new SightingCost{&sighting, start_.parameters().model}), nullptr,
        cameras[f]->data(), tag.data(), &shift, lens_.data());
    for (double* known : {tag.data(), &shift, lens_.data()})
      problem.SetParameterBlockConstant(known);
  });
  const std::optional<double> cost = solve(problem);
  return cost ? std::optional(2.0 * *cost) : std::nullopt;
}

TagGraph TagGraph::with_lens_prior(const Eigen::MatrixXd& prior) const {
  TagGraph result = *this;
  result.lens_ = lens_of(start_.parameters());
  result.lens_prior = prior;
  return result;
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

}  // namespace penumbra
