#include "calib/camera_calibration.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

namespace penumbra {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
// Views whose boards are all within this of parallel do not tell focal length from distance.
constexpr double kLeastTilt_deg = 8.0;
constexpr double kWorthwhile = 0.97;  // of the held-out error: what a further freedom must bring

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// RMS distance between the corners that two views share [px]; infinite when they share few.
double view_distance(const TargetView& a, const TargetView& b) {
  double sum = 0.0;
  int count = 0;
  auto j = b.corners.begin();
  for (const TargetCorner& corner : a.corners) {
    while (j != b.corners.end() && j->point < corner.point) ++j;
    if (j == b.corners.end()) break;
    if (j->point != corner.point) continue;
    sum += (j->pixel - corner.pixel).squaredNorm();
    ++count;
  }
  const auto fewer = static_cast<int>(std::min(a.corners.size(), b.corners.size()));
  return 2 * count < fewer || count == 0 ? std::numeric_limits<double>::infinity()
                                         : std::sqrt(sum / count);
}

std::string cell_name(int column, int row) {
  constexpr std::array<const char*, 3> kRows = {"top", "middle", "bottom"};
  constexpr std::array<const char*, 3> kColumns = {"left", "centre", "right"};
  const auto i = static_cast<std::size_t>(column);
  const auto j = static_cast<std::size_t>(row);
  if (row == 1 && column == 1) return "middle";
  if (row == 1) return kColumns[i];
  if (column == 1) return kRows[j];
  return fmt::format("{} {}", kRows[j], kColumns[i]);
}

}  // namespace

std::string_view to_string(CalibrationGrade grade) {
  switch (grade) {
    case CalibrationGrade::good:
      return "good";
    case CalibrationGrade::usable:
      return "usable";
    case CalibrationGrade::poor:
      return "poor";
  }
  return "poor";
}

UncertaintyMap uncertainty_map(const CameraModel& camera, const Eigen::MatrixXd& covariance,
                               int columns, int rows) {
  UncertaintyMap map;
  map.columns = columns;
  map.rows = rows;
  double sum = 0.0;
  int count = 0;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const Eigen::Vector2d pixel((i + 0.5) * camera.width() / columns - 0.5,
                                  (j + 0.5) * camera.height() / rows - 0.5);
      const auto here = projection_covariance(camera, covariance, pixel);
      if (!here) {
        map.sigma_px.push_back(std::numeric_limits<double>::quiet_NaN());
        continue;
      }
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(*here);
      const double sigma = std::sqrt(std::max(eigen.eigenvalues()[1], 0.0));
      map.sigma_px.push_back(sigma);
      map.largest_px = std::max(map.largest_px, sigma);
      sum += sigma;
      ++count;
    }
  }
  map.mean_px = count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
  return map;
}

ProjectionDifference projection_difference(const CameraModel& a, const CameraModel& b) {
  constexpr int kColumns = 32;
  constexpr int kRows = 24;
  ProjectionDifference difference;
  int count = 0;
  for (int j = 0; j < kRows; ++j) {
    for (int i = 0; i < kColumns; ++i) {
      const Eigen::Vector2d pixel((a.width() - 1.0) * i / (kColumns - 1),
                                  (a.height() - 1.0) * j / (kRows - 1));
      const auto direction = a.unproject(pixel);
      if (!direction) continue;
      const auto other = b.project_extended(*direction);
      if (!other) continue;
      const double distance = (*other - pixel).norm();
      difference.mean_px += distance;
      difference.largest_px = std::max(difference.largest_px, distance);
      ++count;
    }
  }
  difference.mean_px =
      count > 0 ? difference.mean_px / count : std::numeric_limits<double>::quiet_NaN();
  return difference;
}

struct CameraCalibrator::Impl {
  Target target;
  CalibrationOptions options;
  std::optional<TargetDetector> detector;
  std::vector<CalibrationPicture> pictures;
  int width = 0;
  int height = 0;
  std::string first;  // picture that set the size

  [[nodiscard]] Result<void> check_found() const;
  void leave_out_blurred();
  void leave_out_surplus();
  [[nodiscard]] std::vector<CalibrationView> used_views();
  void refine_corners(const CalibrationSolution& solution);
  [[nodiscard]] Result<CalibrationSolution> first_solution(
      const std::vector<CalibrationView>& views) const;
  [[nodiscard]] Result<void> check_solution(const CalibrationSolution& solution,
                                            const std::vector<CalibrationView>& views) const;
  void choose_model(CameraCalibration& result, const std::vector<CalibrationView>& views) const;
  void judge(CameraCalibration& result) const;
};

CameraCalibrator::CameraCalibrator(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
CameraCalibrator::CameraCalibrator(CameraCalibrator&&) noexcept = default;
CameraCalibrator& CameraCalibrator::operator=(CameraCalibrator&&) noexcept = default;
CameraCalibrator::~CameraCalibrator() = default;

Result<CameraCalibrator> CameraCalibrator::create(const Target& target,
                                                  const CalibrationOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->target = target;
  impl->options = options;
  Result<TargetDetector> detector = TargetDetector::create(target);
  if (!detector) return tl::unexpected(detector.error());
  impl->detector.emplace(std::move(*detector));
  return CameraCalibrator(std::move(impl));
}

Result<void> CameraCalibrator::add(const std::string& name, ImageView luma) {
  Impl& self = *impl_;
  if (self.first.empty()) {
    self.first = name;
    self.width = luma.width;
    self.height = luma.height;
  } else if (luma.width != self.width || luma.height != self.height) {
    return fail("{}: is {} x {} px, but {} is {} x {}; give pictures of one camera and one size",
                name, luma.width, luma.height, self.first, self.width, self.height);
  }
  CalibrationPicture picture;
  picture.name = name;
  picture.width = luma.width;
  picture.height = luma.height;
  picture.view = self.detector->detect(luma);
  picture.left_out = picture.view.problem;
  if (picture.left_out.empty()) {
    // Less than a finger's tremor apart: the same view once more weighs its errors double.
    const double nearest = 0.002 * self.width;
    for (const CalibrationPicture& other : self.pictures) {
      if (!other.left_out.empty() || view_distance(picture.view, other.view) > nearest) continue;
      picture.left_out = fmt::format("the same view as {}", other.name);
      break;
    }
  }
  if (picture.left_out.empty()) {
    picture.luma.reserve(static_cast<std::size_t>(luma.width) *
                         static_cast<std::size_t>(luma.height));
    for (int y = 0; y < luma.height; ++y)
      picture.luma.insert(picture.luma.end(), luma.row(y), luma.row(y) + luma.width);
  }
  self.pictures.push_back(std::move(picture));
  return {};
}

void CameraCalibrator::add_unreadable(const std::string& name, const std::string& why) {
  CalibrationPicture picture;
  picture.name = name;
  picture.left_out = why;
  impl_->pictures.push_back(std::move(picture));
}

Result<void> CameraCalibrator::Impl::check_found() const {
  if (pictures.empty()) return fail("there are no pictures");
  int usable = 0;
  int seen = 0;
  int wide = 0;
  std::map<std::string, int> reasons;
  for (const CalibrationPicture& picture : pictures) {
    if (picture.left_out.empty()) ++usable;
    if (!picture.view.corners.empty()) ++seen;
    if (4 * picture.view.two_cell_tags > static_cast<int>(picture.view.corners.size())) ++wide;
    if (!picture.left_out.empty()) ++reasons[picture.left_out];
  }
  if (wide > usable) {
    return fail(
        "in {} of {} pictures the tags have a black border of two cells, as Kalibr prints them; "
        "libapriltag, which finds tags here and while tracking, reads borders of one cell: print a "
        "sheet with penumbra target",
        wide, pictures.size());
  }
  const auto most =
      std::max_element(reasons.begin(), reasons.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  const std::string because =
      most == reasons.end() ? "" : fmt::format(" ({} times: {})", most->second, most->first);
  if (seen == 0) {
    return fail("the target ({}) is in none of {} pictures{}; is it the right target file?",
                target.description, pictures.size(), because);
  }
  if (usable < 3) {
    return fail(
        "only {} of {} pictures can be used{}, and a camera needs at least 3; take 20, with the "
        "target tilted in several directions and in every part of the image",
        usable, pictures.size(), because);
  }
  return {};
}

void CameraCalibrator::Impl::leave_out_blurred() {
  std::vector<double> blurs;
  for (const CalibrationPicture& picture : pictures) {
    if (picture.left_out.empty() && picture.view.blur_px > 0.0)
      blurs.push_back(picture.view.blur_px);
  }
  if (blurs.size() < 6) return;
  const double limit = std::max(2.0 * median(blurs), 1.5);
  auto left = static_cast<int>(blurs.size());
  for (CalibrationPicture& picture : pictures) {
    if (!picture.left_out.empty() || picture.view.blur_px <= limit || left <= 4) continue;
    picture.left_out =
        fmt::format("blurred: edges are {:.1f} px wide (sigma), {:.1f} in most views",
                    picture.view.blur_px, median(blurs));
    --left;
  }
}

// Of many views those that differ most: each next one is the furthest from all that are chosen.
void CameraCalibrator::Impl::leave_out_surplus() {
  std::vector<std::size_t> candidates;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    if (pictures[i].left_out.empty()) candidates.push_back(i);
  }
  if (candidates.size() <= static_cast<std::size_t>(options.most_views)) return;
  const double largest = 10.0 * width;
  std::vector<double> distance(candidates.size(), largest);
  std::vector<bool> chosen(candidates.size(), false);
  std::size_t next = 0;
  for (int n = 0; n < options.most_views; ++n) {
    chosen[next] = true;
    std::size_t furthest = next;
    double most = -1.0;
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      distance[i] = std::min(distance[i], view_distance(pictures[candidates[i]].view,
                                                        pictures[candidates[next]].view));
      // A view of the whole target says more than one of a corner of it.
      const double worth =
          distance[i] * std::sqrt(static_cast<double>(pictures[candidates[i]].view.corners.size()));
      if (!chosen[i] && worth > most) {
        most = worth;
        furthest = i;
      }
    }
    next = furthest;
  }
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (chosen[i]) continue;
    pictures[candidates[i]].left_out = "much like others: enough views";
    pictures[candidates[i]].luma = {};
  }
}

std::vector<CalibrationView> CameraCalibrator::Impl::used_views() {
  std::vector<CalibrationView> views;
  for (CalibrationPicture& picture : pictures) {
    picture.solved = -1;
    if (!picture.left_out.empty()) continue;
    picture.solved = static_cast<int>(views.size());
    views.push_back({picture.name, picture.view.corners});
  }
  return views;
}

void CameraCalibrator::Impl::refine_corners(const CalibrationSolution& solution) {
  for (CalibrationPicture& picture : pictures) {
    if (picture.solved < 0) continue;
    picture.view =
        detector->refine(picture.picture(), picture.view, solution.camera,
                         solution.views[static_cast<std::size_t>(picture.solved)].T_board_camera);
  }
}

Result<CalibrationSolution> CameraCalibrator::Impl::first_solution(
    const std::vector<CalibrationView>& views) const {
  SolverOptions solver;
  if (options.model) {
    solver.model = *options.model;
    return solve_intrinsics(width, height, target.points, views, solver);
  }
  Result<CalibrationSolution> best = solve_intrinsics(width, height, target.points, views, solver);
  solver.model = DistortionModel::fisheye;
  // A wide lens can't be described by a polynomial in tan(angle): where that fits badly, or not at
  // all, the other is tried before corners are refined with it.
  if (!best || best->noise_px > 0.5 || best->outliers * 20 > best->corners) {
    Result<CalibrationSolution> wide =
        solve_intrinsics(width, height, target.points, views, solver);
    if (wide && (!best || wide->noise_px < best->noise_px)) return wide;
  }
  return best;
}

Result<void> CameraCalibrator::Impl::check_solution(
    const CalibrationSolution& solution, const std::vector<CalibrationView>& views) const {
  const double tilt = tilt_spread(solution.views) * kDegrees;
  if (tilt < kLeastTilt_deg) {
    return fail(
        "all {} views show the target parallel to one plane (within {:.1f} degrees), so focal "
        "length and distance can't be told apart; tilt the target by 30 to 45 degrees in several "
        "directions",
        views.size(), tilt);
  }
  if (solution.noise_px > 3.0 || solution.outliers * 2 > solution.corners) {
    return fail(
        "no camera explains the corners: they are off by {:.1f} px, {} of {} outliers; does the "
        "target file say what is printed (tag size, spacing, squares), and is it one camera with "
        "one focus?",
        solution.rms_all_px, solution.outliers, solution.corners);
  }
  if (target.kind == TargetKind::tags) {
    // Squares of a size that the file does not say look as if all edges were moved.
    std::vector<double> shares;
    std::vector<double> shifts;
    for (std::size_t v = 0; v < views.size(); ++v) {
      std::vector<double> sizes;
      for (std::size_t c = 1; c < views[v].corners.size(); ++c) {
        if (views[v].corners[c].point / 4 == views[v].corners[c - 1].point / 4)
          sizes.push_back((views[v].corners[c].pixel - views[v].corners[c - 1].pixel).norm());
      }
      if (sizes.empty()) continue;
      shares.push_back(2.0 * solution.views[v].edge_shift_px / median(sizes));
      shifts.push_back(solution.views[v].edge_shift_px);
    }
    const double share = median(shares);
    if (std::abs(share) > 0.04 && std::abs(median(shifts)) > 0.8) {
      return fail(
          "the tags' black squares are {:.0f} % {} than the target file says, for the distances "
          "between them; measure tag size and spacing again",
          std::abs(share) * 100.0, share > 0.0 ? "larger" : "smaller");
    }
  }
  const double sigma_f = std::sqrt(solution.covariance(0, 0)) / solution.camera.parameters().fx;
  if (!(sigma_f < 0.2)) {
    return fail(
        "the views leave the focal length open by {:.0f} %; tilt the target by 30 to 45 degrees in "
        "several directions",
        sigma_f * 100.0);
  }
  return {};
}

void CameraCalibrator::Impl::choose_model(CameraCalibration& result,
                                          const std::vector<CalibrationView>& views) const {
  const auto try_one = [&](DistortionModel model, BoardShape shape)
      -> std::optional<std::pair<CalibrationSolution, std::optional<double>>> {
    SolverOptions solver;
    solver.model = model;
    solver.shape = shape;
    Result<CalibrationSolution> solved =
        solve_intrinsics(result.solution, target.points, views, solver);
    if (!solved) return std::nullopt;
    const auto held_out = held_out_error(*solved, target.points, views, solver);
    result.trials.push_back({model, shape, solved->rms_px, held_out, false});
    return std::pair(std::move(*solved), held_out);
  };
  // Simplest first; each must be worth its freedoms.
  const std::vector<DistortionModel> models =
      options.model ? std::vector{*options.model}
                    : std::vector{DistortionModel::plumb_bob, DistortionModel::fisheye,
                                  DistortionModel::rational};
  const BoardShape first_shape = options.shape.value_or(BoardShape::rigid);
  std::optional<std::pair<CalibrationSolution, std::optional<double>>> best;
  std::size_t chosen = 0;
  const auto consider = [&](DistortionModel model, BoardShape shape) {
    auto tried = try_one(model, shape);
    if (!tried) return;
    const bool better =
        !best || (tried->second && best->second && *tried->second < kWorthwhile * *best->second);
    if (!better) return;
    best = std::move(tried);
    chosen = result.trials.size() - 1;
  };
  for (const DistortionModel model : models) consider(model, first_shape);
  if (best && !options.shape) {
    const DistortionModel model = best->first.camera.parameters().model;
    consider(model, BoardShape::bowed);
    // Offsets of their own need every point seen many times.
    if (views.size() >= 8) consider(model, BoardShape::free);
  }
  if (!best) return;
  result.solution = std::move(best->first);
  result.held_out_px = best->second;
  result.trials[chosen].chosen = true;
}

void CameraCalibrator::Impl::judge(CameraCalibration& result) const {
  const CalibrationSolution& solution = result.solution;
  result.uncertainty = uncertainty_map(solution.camera, solution.covariance);
  result.tilt_spread_deg = tilt_spread(solution.views) * kDegrees;
  std::vector<double> blurs;
  std::array<std::array<int, 3>, 3> cells{};
  for (const CalibrationPicture& picture : result.pictures) {
    if (picture.solved < 0) continue;
    blurs.push_back(picture.view.blur_px);
    for (const TargetCorner& corner : picture.view.corners) {
      const auto cell = [](double at, int size) {
        return static_cast<std::size_t>(std::clamp(static_cast<int>(3.0 * at / size), 0, 2));
      };
      ++cells[cell(corner.pixel.y(), height)][cell(corner.pixel.x(), width)];
    }
  }
  result.blur_px = median(blurs);

  std::vector<std::string> empty;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      const int count = cells[static_cast<std::size_t>(row)][static_cast<std::size_t>(column)];
      if (count * 100 < solution.corners) empty.push_back(cell_name(column, row));
    }
  }
  if (!empty.empty())
    result.advice.push_back(fmt::format("no views near the {}", fmt::join(empty, ", the ")));
  if (result.tilt_spread_deg < 40.0) {
    result.advice.push_back(fmt::format("tilt the target more: views differ by {:.0f} degrees only",
                                        result.tilt_spread_deg));
  }
  if (solution.views.size() < 10)
    result.advice.push_back(fmt::format("{} views are few: take 20", solution.views.size()));
  if (result.blur_px > 1.5)
    result.advice.push_back(fmt::format(
        "pictures are blurred ({:.1f} px): hold still, focus, more light", result.blur_px));
  if (solution.shape != BoardShape::rigid)
    result.advice.push_back("the target is not flat or not true: glue it on glass or a board");

  const double error = result.held_out_px.value_or(solution.rms_px);
  const double sigma = result.uncertainty.largest_px;
  const bool finite = std::isfinite(sigma) && std::isfinite(error);
  result.grade = finite && sigma <= 0.5 && error <= 1.0   ? CalibrationGrade::good
                 : finite && sigma <= 2.0 && error <= 2.0 ? CalibrationGrade::usable
                                                          : CalibrationGrade::poor;
  std::string text = fmt::format(
      "{}: projection is known to {:.2f} px (1 sigma) at the worst place in the image, {:.2f} on "
      "average; views left out of the solution are explained to {:.2f} px",
      to_string(result.grade), sigma, result.uncertainty.mean_px, error);
  if (result.grade != CalibrationGrade::good) {
    if (result.advice.empty()) {
      text += error > 1.0
                  ? "; the corners are off by too much: is the target flat, the focus fixed?"
                  : "; take more views";
    } else {
      text += fmt::format("; {}", fmt::join(result.advice, "; "));
    }
  } else if (!empty.empty()) {
    text += fmt::format("; {}", result.advice.front());
  }
  result.verdict = text;
}

Result<CameraCalibration> CameraCalibrator::finish() {
  Impl& self = *impl_;
  if (const auto ok = self.check_found(); !ok) return tl::unexpected(ok.error());
  self.leave_out_blurred();
  self.leave_out_surplus();
  std::vector<CalibrationView> views = self.used_views();
  Result<CalibrationSolution> solution = self.first_solution(views);
  if (!solution) return tl::unexpected(solution.error());
  if (const auto ok = self.check_solution(*solution, views); !ok) return tl::unexpected(ok.error());
  // Corners once more where the solution puts them; twice, since the first solution is off by what
  // straight lines on a bent picture are off.
  for (int round = 0; round < 2; ++round) {
    self.refine_corners(*solution);
    views = self.used_views();
    SolverOptions solver;
    solver.model = solution->camera.parameters().model;
    solution = solve_intrinsics(*solution, self.target.points, views, solver);
    if (!solution) return tl::unexpected(solution.error());
  }
  CameraCalibration result;
  result.solution = std::move(*solution);
  self.choose_model(result, views);
  if (const auto ok = self.check_solution(result.solution, views); !ok)
    return tl::unexpected(ok.error());
  result.pictures = std::move(self.pictures);
  self.judge(result);
  return result;
}

}  // namespace penumbra
