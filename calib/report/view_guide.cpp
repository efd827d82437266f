#include "calib/report/view_guide.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>
#include <utility>

#include "calib/camera_calibration.hpp"
#include "calib/target/image_cells.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/detection/pose_solver.hpp"

namespace penumbra {
namespace {

constexpr int kColumns = 5;           // columns of image cells
constexpr int kRows = 4;              // rows of image cells
constexpr int kCornersInCell = 2;     // minimum number of corners in a covered cell
constexpr double kCellsNeeded = 0.9;  // fraction of cells that must be covered
constexpr int kViewsNeeded = 12;
constexpr double kSizesNeeded = 1.6;           // size ratio of the nearest and the furthest view
constexpr double kTiltNeeded = radians(40.0);  // required angle between two views
// Distances between the corners of two images, as fractions of the image's width.
constexpr double kMinFirstMove =
    0.08;  // views are different from here on, before the first solution
constexpr double kMaxSameViewMove = 0.01;  // views are equal up to here, after the first solution
constexpr double kMaxMotion = 0.012;       // the target rests up to here, in consecutive images
constexpr double kMaxBlur_px = 1.6;        // maximum blur [px]
constexpr std::size_t kFirstViews = 4;
constexpr std::size_t kViewsPerChoice = 4;  // views between two lens choices

}  // namespace

std::optional<Eigen::MatrixXd> view_information(const CameraModel& camera,
                                                const std::vector<Eigen::Vector3d>& board,
                                                const std::vector<TargetCorner>& corners) {
  std::vector<PointObservation> points;
  for (const TargetCorner& corner : corners)
    points.push_back({board[static_cast<std::size_t>(corner.point)], corner.pixel});
  const auto found = find_pose(camera, points);
  if (!found) return std::nullopt;
  const int n = 4 + coefficient_count(camera.parameters().model);
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n, n);
  Eigen::MatrixXd B = Eigen::MatrixXd::Zero(n, 7);
  Eigen::Matrix<double, 7, 7> C = Eigen::Matrix<double, 7, 7>::Zero();
  const auto T_camera_board = found->T_map_camera.inverse();
  bool shifts = false;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d p = T_camera_board * points[i].p_map;
    const Eigen::MatrixXd J_lens = lens_jacobian(camera, p.head<2>() / p.z());
    Eigen::Matrix<double, 2, 7> J_view;
    J_view << reprojection_jacobian(camera, found->T_map_camera, points[i].p_map),
        corners[i].spread;
    shifts = shifts || !corners[i].spread.isZero();
    A += J_lens.transpose() * J_lens;
    B += J_lens.transpose() * J_view;
    C += J_view.transpose() * J_view;
  }
  C(6, 6) += shifts ? 1e-6 : 1.0;
  const Eigen::LDLT<Eigen::Matrix<double, 7, 7>> pose(C);
  const Eigen::MatrixXd information = A - B * pose.solve(B.transpose());
  if (pose.info() != Eigen::Success || !information.allFinite()) return std::nullopt;
  return information;
}

struct ViewGuide::Impl {
  Target target;
  GuideOptions options;
  std::optional<TargetDetector> detector;
  std::vector<CalibrationView> views;
  std::vector<double> sizes;       // mean edge length of the target in each view [px]
  std::vector<TargetCorner> last;  // corners in the previous image
  std::array<int, kColumns * kRows> cells{};
  ModelTrial lens;  // the lens model in use
  std::optional<CalibrationSolution> solution;
  UncertaintyMap uncertainty;
  GuideProgress progress;
  int width = 0;
  int height = 0;

  [[nodiscard]] ImageCells image_cells() const { return {kColumns, kRows, width, height}; }

  [[nodiscard]] double size_of(const std::vector<TargetCorner>& corners) const {
    const std::vector<const TargetCorner*> at = corners_by_point(target, corners);
    double sum = 0.0;
    int count = 0;
    for (const auto& [a, b] : target.edges) {
      const TargetCorner* p = at[static_cast<std::size_t>(a)];
      const TargetCorner* q = at[static_cast<std::size_t>(b)];
      if (p == nullptr || q == nullptr) continue;
      sum += (p->pixel - q->pixel).norm();
      ++count;
    }
    return count > 0 ? sum / count : 0.0;
  }

  // Returns the relative reduction of the mean uncertainty by a view.
  [[nodiscard]] double gain_of(const std::vector<TargetCorner>& corners) const {
    const auto information = view_information(solution->camera, solution->board, corners);
    if (!information) return 0.0;
    const Eigen::MatrixXd& P = solution->covariance;
    const double noise = solution->noise_px * solution->noise_px * solution->covariance_inflation;
    // (P^-1 + I / noise)^-1 without inverting P, whose entries differ by orders of magnitude.
    const Eigen::MatrixXd identity = Eigen::MatrixXd::Identity(P.rows(), P.cols());
    const Eigen::MatrixXd after = (identity + P * *information / noise).partialPivLu().solve(P);
    const double mean = uncertainty_map(solution->camera, after, 16, 12).mean_px;
    if (!std::isfinite(mean) || !(uncertainty.mean_px > 0.0)) return 0.0;
    return std::max(0.0, 1.0 - mean / uncertainty.mean_px);
  }

  void take(std::vector<TargetCorner> corners) {
    for (const TargetCorner& corner : corners) ++cells[image_cells().at(corner.pixel)];
    sizes.push_back(size_of(corners));
    views.push_back({fmt::format("view {}", views.size() + 1), std::move(corners)});
    if (views.size() < kFirstViews) return;
    SolverOptions solver;
    solver.stop = options.stop;
    const auto solve_as = [&](DistortionModel model, bool without_k3) {
      solver.model = model;
      solver.without_k3 = without_k3;
      return solution ? solve_intrinsics(*solution, target.points, views, solver)
                      : solve_intrinsics(width, height, target.points, views, solver);
    };
    Result<CalibrationSolution> solved = solve_as(lens.model, lens.without_k3);
    // The lens choice can't find a wide lens if it starts from plumb_bob.
    const bool explains = solved && solved->explains_corners();
    if (!options.model && !explains && lens.model == DistortionModel::plumb_bob) {
      Result<CalibrationSolution> wide = solve_as(DistortionModel::fisheye, false);
      if (wide && (!solved || wide->noise_px < solved->noise_px)) {
        lens.model = DistortionModel::fisheye;
        lens.without_k3 = false;
        solved = std::move(wide);
      }
    }
    if (!solved) return;
    if (views.size() % kViewsPerChoice == 0) {
      std::vector<ModelTrial> trials;
      auto chosen =
          choose_lens(*solved, target.points, views,
                      {options.model, options.for_kalibr, options.stop}, BoardShape::rigid, trials);
      if (chosen) {
        lens = trials[chosen->trial];
        solved = std::move(chosen->solution);
      }
    }
    const UncertaintyMap map = uncertainty_map(solved->camera, solved->covariance, 16, 12);
    if (!std::isfinite(map.mean_px)) return;
    uncertainty = map;
    solution = std::move(*solved);
  }

  void measure() {
    std::vector<std::size_t> missing;
    for (std::size_t i = 0; i < cells.size(); ++i) {
      if (cells[i] < kCornersInCell) missing.push_back(i);
    }
    const double seen =
        1.0 - static_cast<double>(missing.size()) / static_cast<double>(cells.size());
    progress.views = static_cast<int>(views.size());
    progress.coverage = {kColumns, kRows, std::vector<bool>(cells.size(), true), std::nullopt};
    for (const std::size_t cell : missing) progress.coverage.seen[cell] = false;
    progress.image = std::min(1.0, seen / kCellsNeeded);
    const auto [least, greatest] = std::minmax_element(sizes.begin(), sizes.end());
    if (!sizes.empty() && *least > 0.0)
      progress.size = std::clamp(std::log(*greatest / *least) / std::log(kSizesNeeded), 0.0, 1.0);
    if (solution) {
      progress.tilt = std::min(1.0, tilt_spread(solution->views) / kTiltNeeded);
      progress.largest_px = uncertainty.largest_px;
      progress.lens = lens_name(lens);
      progress.certainty = std::min(1.0, options.goal_px / uncertainty.largest_px);
    }
    progress.enough = progress.image >= 1.0 && progress.size >= 1.0 && progress.tilt >= 1.0 &&
                      progress.certainty >= 1.0 && progress.views >= kViewsNeeded;
    const double lowest = std::min({progress.image, progress.size, progress.tilt});
    const auto advise = [&](std::string to_a_person, std::string_view missing_in_a_recording) {
      progress.advice = options.held ? std::move(to_a_person)
                                     : fmt::format("still missing: {}", missing_in_a_recording);
    };
    if (progress.enough) {
      progress.advice = "enough: the lens is known";
    } else if (views.empty()) {
      advise(last.empty() ? "show the target to the camera" : "hold the target still",
             "a view of the target");
    } else if (!solution) {
      advise("hold the target still elsewhere, each time tilted to another side",
             "first views, each tilted to another side");
    } else if (lowest >= 1.0) {
      advise("more views, each of them a little different", "more views");
    } else if (lowest == progress.tilt) {
      advise("tilt the target, to other sides too", "views from other sides, tilted more");
    } else if (lowest == progress.size) {
      advise("come closer, or go further away", "views from closer, or from further away");
    } else {
      const std::size_t next = missing[missing.size() / 2];
      const std::string cell = image_cells().name(next);
      progress.coverage.next = next;
      advise(fmt::format("move the target to the {}", cell), fmt::format("views at the {}", cell));
    }
  }
};

ViewGuide::ViewGuide(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ViewGuide::ViewGuide(ViewGuide&&) noexcept = default;
ViewGuide::~ViewGuide() = default;

Result<ViewGuide> ViewGuide::create(const Target& target, const GuideOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->target = target;
  impl->options = options;
  impl->lens.model = options.model.value_or(DistortionModel::plumb_bob);
  impl->lens.without_k3 =
      impl->lens.model == DistortionModel::plumb_bob && (!options.model || options.for_kalibr);
  PENUMBRA_TRY(TargetDetector detector, TargetDetector::create(target));
  impl->detector.emplace(std::move(detector));
  impl->measure();
  return ViewGuide(std::move(impl));
}

GuideResult ViewGuide::look(ImageView luma) {
  Impl& self = *impl_;
  self.width = luma.width;
  self.height = luma.height;
  TargetView view = self.detector->detect(luma);
  const std::vector<TargetCorner> before = std::exchange(self.last, view.corners);
  GuideResult result;
  result.corners = view.corners;
  result.tags = view.tags;
  const auto because = [&](std::string why) {
    result.why = std::move(why);
    self.measure();
    return result;
  };
  if (!view.problem.empty()) return because(view.problem);
  if (view.blur_px > kMaxBlur_px)
    return because(self.options.held ? "blurred: hold still, focus, more light" : "blurred");
  if (self.options.held && !before.empty() &&
      corner_distance(view.corners, before) > kMaxMotion * luma.width)
    return because("it moves: hold still");
  // Rejects repeated views: they lower the noise, but count errors of light and board twice.
  const double least_px = (self.solution ? kMaxSameViewMove : kMinFirstMove) * luma.width;
  for (const CalibrationView& other : self.views) {
    if (corner_distance(view.corners, other.corners) <= least_px)
      return because("too much like a view before");
  }
  if (self.solution) {
    result.gain = self.gain_of(view.corners);
    if (result.gain < self.options.min_gain) return because("adds no information");
  }
  result.taken = true;
  self.take(std::move(view.corners));
  self.measure();
  return result;
}

const GuideProgress& ViewGuide::progress() const {
  return impl_->progress;
}

}  // namespace penumbra
