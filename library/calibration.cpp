#include <algorithm>
#include <cmath>
#include <penumbra/calibration.hpp>
#include <set>
#include <utility>

#include "calib/camera_calibration.hpp"
#include "calib/solver/lens_choice.hpp"
#include "core/camera/camera_file.hpp"
#include "library/support.hpp"

namespace penumbra::calibration {

struct Target::Impl {
  penumbra::Target target;
};

struct Calibration::Impl {
  CameraCalibration result;
  penumbra::Target target;
};

struct Access {
  [[nodiscard]] static const penumbra::Target& target_of(const Target& target) {
    return target.impl_->target;
  }
  [[nodiscard]] static Calibration make(CameraCalibration result, penumbra::Target target) {
    return Calibration(std::make_shared<const Calibration::Impl>(
        Calibration::Impl{std::move(result), std::move(target)}));
  }
};

namespace {

constexpr std::size_t kMinViews = 3;
constexpr int kMaxSide_px = 32768;

CalibrationOptions checked_options(const Options& options) {
  constexpr int kMaxViews = 10'000;
  CalibrationOptions checked;
  if (options.model) checked.model = types::to_internal(*options.model);
  if (options.max_views < static_cast<int>(kMinViews) || options.max_views > kMaxViews) {
    throw_failure("max_views: is {}; give {} to {}", options.max_views, kMinViews, kMaxViews);
  }
  checked.max_views = options.max_views;
  return checked;
}

CalibrationView checked_view(const CornerView& view, std::size_t index, std::size_t points,
                             int width, int height) {
  CalibrationView checked;
  checked.name = view.name.empty() ? fmt::format("views[{}]", index) : view.name;
  std::set<int> seen;
  for (const Corner& corner : view.corners) {
    if (corner.point < 0 || static_cast<std::size_t>(corner.point) >= points) {
      throw_failure("{}: point {} does not exist; the target has {} points", checked.name,
                    corner.point, points);
    }
    if (!seen.insert(corner.point).second) {
      throw_failure("{}: names point {} twice", checked.name, corner.point);
    }
    const auto [x, y] = corner.pixel;
    if (!(x >= -0.5 && y >= -0.5 && x <= width - 0.5 && y <= height - 0.5)) {
      throw_failure("{}: point {} is at ({}, {}), outside the image of {} x {} px", checked.name,
                    corner.point, x, y, width, height);
    }
    checked.corners.push_back({corner.point, to_eigen(corner.pixel)});
  }
  std::ranges::sort(checked.corners, {}, &TargetCorner::point);
  return checked;
}

std::vector<CalibrationView> checked_views(const std::vector<CornerView>& views, std::size_t points,
                                           int width, int height) {
  if (width < 1 || height < 1 || width > kMaxSide_px || height > kMaxSide_px) {
    throw_failure("width, height: are {} x {}; give 1 to {} pixels", width, height, kMaxSide_px);
  }
  if (views.size() < kMinViews) {
    throw_failure("{} views are too few, a camera needs at least {}; take 20", views.size(),
                  kMinViews);
  }
  std::vector<CalibrationView> checked;
  for (std::size_t i = 0; i < views.size(); ++i) {
    checked.push_back(checked_view(views[i], i, points, width, height));
  }
  return checked;
}

std::vector<Eigen::Vector3d> checked_points(const std::vector<Vector3>& points) {
  constexpr double kMax_m = 1e4;
  constexpr std::size_t kMinPoints = 4;
  if (points.size() < kMinPoints) {
    throw_failure("points: {} are too few; give at least {}", points.size(), kMinPoints);
  }
  std::vector<Eigen::Vector3d> board;
  for (std::size_t i = 0; i < points.size(); ++i) {
    board.push_back(to_eigen(points[i]));
    if (!board.back().allFinite() || board.back().cwiseAbs().maxCoeff() > kMax_m) {
      throw_failure("points[{}]: ({}, {}, {}) is no point within {:g} m", i, points[i][0],
                    points[i][1], points[i][2], kMax_m);
    }
  }
  return board;
}

// Fails if no camera explains the corners, or if the views do not determine it.
Result<void> check_solution(const CalibrationSolution& solution) {
  if (auto tilted = check_tilt(solution); !tilted) return tilted;
  if (solution.contradicts_corners()) {
    return fail(
        "no camera explains the corners: they are off by {:.1f} px, {} of {} outliers; are the "
        "points right, and is it one camera with one focus?",
        solution.rms_all_px, solution.outliers, solution.corners);
  }
  return check_focal_length(solution);
}

CameraCalibration solve(int width, int height, const std::vector<Eigen::Vector3d>& board,
                        const std::vector<CalibrationView>& views,
                        const CalibrationOptions& options) {
  LensChoice choice;
  choice.model = options.model;
  const CalibrationSolution first =
      value_or_throw(first_solution(width, height, board, views, choice));
  throw_if_failed(check_solution(first));
  CameraCalibration result;
  ChosenLens chosen =
      value_or_throw(choose_lens(first, board, views, choice, options.shape, result.trials));
  throw_if_failed(check_solution(chosen.solution));
  result.solution = std::move(chosen.solution);
  result.held_out_px = chosen.held_out_px;
  for (std::size_t i = 0; i < views.size(); ++i) {
    CalibrationImage& image = result.images.emplace_back();
    image.name = views[i].name;
    image.view.corners = views[i].corners;
    image.solved = static_cast<int>(i);
    image.width = width;
    image.height = height;
  }
  result.tone_unknown = "there are no images";
  judge(result);
  return result;
}

}  // namespace

Target::Target(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
Target::Target(const Target&) = default;
Target& Target::operator=(const Target&) = default;
Target::~Target() = default;

Target Target::load(const std::filesystem::path& file) {
  return guarded([&] {
    return Target(std::make_shared<const Impl>(Impl{value_or_throw(load_target(file))}));
  });
}

Target Target::chessboard(int columns, int rows, double square_m) {
  return guarded([&] {
    return Target(std::make_shared<const Impl>(
        Impl{value_or_throw(chessboard_target(columns, rows, square_m))}));
  });
}

std::string Target::description() const {
  return impl_->target.description;
}

std::vector<Vector3> Target::points() const {
  std::vector<Vector3> points;
  for (const Eigen::Vector3d& p : impl_->target.points) points.push_back(to_public(p));
  return points;
}

Calibration::Calibration(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
Calibration::Calibration(const Calibration&) = default;
Calibration& Calibration::operator=(const Calibration&) = default;
Calibration::~Calibration() = default;

CameraModel Calibration::camera() const {
  return types::Access::make(impl_->result.solution.camera);
}

void Calibration::save(const std::filesystem::path& file, const std::string& date,
                       CameraFileFormat format) const {
  guarded([&] {
    const CalibrationRecord record = record_of(impl_->result, impl_->target, date);
    throw_if_failed(
        save_camera(file, impl_->result.solution.camera, types::format_of(format), &record));
  });
}

std::vector<std::string> Calibration::parameter_names() const {
  std::vector<std::string> names = {"fx", "fy", "cx", "cy"};
  const penumbra::DistortionModel model = impl_->result.solution.camera.parameters().model;
  for (int i = 0; i < coefficient_count(model); ++i) {
    names.push_back(coefficient_name(model, static_cast<std::size_t>(i)));
  }
  return names;
}

std::vector<double> Calibration::covariance() const {
  const Eigen::MatrixXd& covariance = impl_->result.solution.covariance;
  std::vector<double> values;
  for (Eigen::Index row = 0; row < covariance.rows(); ++row) {
    for (Eigen::Index column = 0; column < covariance.cols(); ++column) {
      values.push_back(covariance(row, column));
    }
  }
  return values;
}

double Calibration::rms_px() const {
  return impl_->result.solution.rms_px;
}
std::optional<double> Calibration::held_out_px() const {
  return impl_->result.held_out_px;
}
double Calibration::projection_mean_px() const {
  return impl_->result.uncertainty.mean_px;
}
double Calibration::projection_largest_px() const {
  return impl_->result.uncertainty.largest_px;
}

Grade Calibration::grade() const {
  switch (impl_->result.grade) {
    case CalibrationGrade::good:
      return Grade::good;
    case CalibrationGrade::usable:
      return Grade::usable;
    case CalibrationGrade::poor:
      break;
  }
  return Grade::poor;
}

std::string Calibration::verdict() const {
  return impl_->result.verdict;
}
std::vector<std::string> Calibration::advice() const {
  return impl_->result.advice;
}

std::vector<ViewResult> Calibration::views() const {
  std::vector<ViewResult> views;
  for (const CalibrationImage& image : impl_->result.images) {
    ViewResult& view = views.emplace_back();
    view.name = image.name;
    view.used = image.solved >= 0;
    view.reason = image.left_out;
    if (view.used) {
      view.rms_px = impl_->result.solution.views[static_cast<std::size_t>(image.solved)].rms_px;
    }
  }
  return views;
}

struct Calibrator::Impl {
  penumbra::Target target;
  CalibrationOptions options;
  CameraCalibrator calibrator;
  std::vector<std::uint8_t> scratch;
};

Calibrator::Calibrator(Calibrator&&) noexcept = default;
Calibrator& Calibrator::operator=(Calibrator&&) noexcept = default;
Calibrator::~Calibrator() = default;

Calibrator::Calibrator(const Target& target, const Options& options)
    : impl_(guarded([&] {
        const penumbra::Target& checked = Access::target_of(target);
        const CalibrationOptions chosen = checked_options(options);
        return std::make_unique<Impl>(
            Impl{checked, chosen, value_or_throw(CameraCalibrator::create(checked, chosen)), {}});
      })) {}

void Calibrator::add(const std::string& name, const ImageView& image) {
  if (!impl_) throw_failure("calibrator: was moved from; make another one");
  const Frame frame = checked_frame(image, name);
  guarded([&] { throw_if_failed(impl_->calibrator.add(name, luma(frame, impl_->scratch))); });
}

Calibration Calibrator::solve() {
  if (!impl_) throw_failure("calibrator: was moved from; make another one");
  return guarded([&] {
    CameraCalibrator fresh =
        value_or_throw(CameraCalibrator::create(impl_->target, impl_->options));
    CameraCalibrator filled = std::exchange(impl_->calibrator, std::move(fresh));
    return Access::make(value_or_throw(filled.finish()), impl_->target);
  });
}

Calibration calibrate(int width, int height, const std::vector<Vector3>& points,
                      const std::vector<CornerView>& views, const Options& options) {
  return guarded([&] {
    const std::vector<Eigen::Vector3d> board = checked_points(points);
    const auto checked = checked_views(views, board.size(), width, height);
    penumbra::Target target;
    target.points = board;
    target.description = fmt::format("{} points", board.size());
    return Access::make(solve(width, height, board, checked, checked_options(options)),
                        std::move(target));
  });
}

}  // namespace penumbra::calibration
