// The uncertainty of a calibration, its grade, and advice. See docs/calibration.md#verdict.
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/camera_calibration.hpp"
#include "calib/target/image_cells.hpp"
#include "core/statistics.hpp"
#include "core/text/enum_names.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

constexpr double kGoodTilt_deg = 40.0;
constexpr std::size_t kGoodViews = 10;
constexpr double kMaxCornerDistance =
    0.05;  // maximum distance to a corner, fraction of the image's diagonal

// Returns the name of the cell with the largest uncertainty: "the top left".
std::string worst_cell_name(const UncertaintyMap& map, const ImageCells& cells) {
  const ImageCells of_map{map.columns, map.rows, cells.width, cells.height};
  std::size_t worst = 0;
  double max_sigma_px = -1.0;
  for (std::size_t cell = 0; cell < map.sigma_px.size(); ++cell) {
    if (!(map.sigma_px[cell] > max_sigma_px)) continue;  // skips NaN as well
    worst = cell;
    max_sigma_px = map.sigma_px[cell];
  }
  return "the " + cells.name(cells.at(of_map.middle(worst)));
}

}  // namespace

std::string_view to_string(CalibrationGrade grade) {
  constexpr auto kNames =
      std::to_array<EnumName<CalibrationGrade>>({{CalibrationGrade::good, "good"},
                                                 {CalibrationGrade::usable, "usable"},
                                                 {CalibrationGrade::poor, "poor"}});
  return name_of(kNames, grade);
}

UncertaintyMap uncertainty_map(const CameraModel& camera, const Eigen::MatrixXd& covariance,
                               int columns, int rows) {
  UncertaintyMap map;
  map.columns = columns;
  map.rows = rows;
  double sum = 0.0;
  int count = 0;
  const ImageCells cells{columns, rows, camera.width(), camera.height()};
  for (std::size_t cell = 0; cell < cells.count(); ++cell) {
    const auto here = projection_covariance(camera, covariance, cells.middle(cell));
    if (!here) {
      map.sigma_px.push_back(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    // Infinite if the covariance is not finite.
    double sigma = std::numeric_limits<double>::infinity();
    if (here->allFinite()) {
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(*here);
      sigma = std::sqrt(std::max(eigen.eigenvalues()[1], 0.0));
    }
    map.sigma_px.push_back(sigma);
    map.largest_px = std::max(map.largest_px, sigma);
    sum += sigma;
    ++count;
  }
  map.mean_px = sum / count;
  // A lens with non-monotonic distortion in the image has an infinite uncertainty.
  if (count == 0 || (count < columns * rows && non_monotonic_place_in_image(camera)))
    map.mean_px = map.largest_px = std::numeric_limits<double>::infinity();
  return map;
}

void raise_to_difference(UncertaintyMap& map, const CameraModel& camera, const CameraModel& other,
                         std::span<const CalibrationImage> images) {
  const double near = kMaxCornerDistance * std::hypot(camera.width(), camera.height());
  const ImageCells cells{map.columns, map.rows, camera.width(), camera.height()};
  std::vector<double> differences(map.sigma_px.size(), 0.0);
  std::vector<bool> seen(map.sigma_px.size(), false);  // a detected corner is near
  double largest = 0.0;                                // maximum difference in seen cells
  for (std::size_t cell = 0; cell < cells.count(); ++cell) {
    const Eigen::Vector2d pixel = cells.middle(cell);
    const auto direction = camera.unproject(pixel);
    const auto reprojected = direction ? other.project_extended(*direction) : std::nullopt;
    if (reprojected) differences[cell] = (*reprojected - pixel).norm();
    for (const CalibrationImage& image : images) {
      if (image.solved < 0 || seen[cell]) continue;
      seen[cell] = std::ranges::any_of(image.view.corners, [&](const TargetCorner& corner) {
        return (corner.pixel - pixel).norm() < near;
      });
    }
    if (seen[cell]) largest = std::max(largest, differences[cell]);
  }
  double sum = 0.0;
  int count = 0;
  for (std::size_t cell = 0; cell < cells.count(); ++cell) {
    double& sigma = map.sigma_px[cell];
    if (std::isnan(sigma)) continue;
    sigma = std::max(sigma, seen[cell] ? differences[cell] : largest);
    map.largest_px = std::max(map.largest_px, sigma);
    sum += sigma;
    ++count;
  }
  if (std::isfinite(map.mean_px) && count > 0) map.mean_px = sum / count;
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
  difference.skipped = 1.0 - static_cast<double>(count) / (kColumns * kRows);
  difference.mean_px =
      count > 0 ? difference.mean_px / count : std::numeric_limits<double>::quiet_NaN();
  return difference;
}

void judge(CameraCalibration& result) {
  const CalibrationSolution& solution = result.solution;
  const int width = solution.camera.width();
  const int height = solution.camera.height();
  result.uncertainty = uncertainty_map(solution.camera, solution.covariance);
  // The views do not distinguish these lenses, so their difference is uncertainty.
  for (const ModelTrial& trial : result.trials) {
    if (trial.rival && !trial.non_monotonic_px)
      raise_to_difference(result.uncertainty, solution.camera, trial.camera, result.images);
  }
  result.table = table_volume_uncertainty(solution.camera, solution.covariance);
  result.tilt_spread_deg = degrees(tilt_spread(solution.views));
  std::vector<double> blurs;
  const ImageCells cells{3, 3, width, height};
  std::vector<int> seen(cells.count(), 0);
  for (const CalibrationImage& image : result.images) {
    if (image.solved < 0) continue;
    blurs.push_back(image.view.blur_px);
    for (const TargetCorner& corner : image.view.corners) ++seen[cells.at(corner.pixel)];
  }
  result.blur_px = upper_median(std::move(blurs));

  std::vector<std::string> empty;
  std::vector<std::string> nearly_empty;
  for (std::size_t cell = 0; cell < seen.size(); ++cell) {
    if (seen[cell] * 100 < solution.corners)
      (seen[cell] == 0 ? empty : nearly_empty).push_back(cells.name(cell));
  }
  if (!empty.empty())
    result.advice.push_back(fmt::format("no views near the {}", fmt::join(empty, ", the ")));
  if (!nearly_empty.empty())
    result.advice.push_back(
        fmt::format("few views near the {}", fmt::join(nearly_empty, ", the ")));
  const bool has_gaps = !result.advice.empty();
  if (result.other_board) result.advice.insert(result.advice.begin(), *result.other_board);
  result.advice.insert(result.advice.begin(), result.target_differences.begin(),
                       result.target_differences.end());
  if (result.tilt_spread_deg < kGoodTilt_deg) {
    // Rounded down, so that 39.9 does not look like 40.
    result.advice.push_back(
        fmt::format("tilt the target by 30 to 45 degrees to every side: no two views differ by "
                    "more than {:.0f} degrees, {:.0f} are good",
                    std::floor(result.tilt_spread_deg), kGoodTilt_deg));
  }
  if (solution.views.size() < kGoodViews) {
    result.advice.push_back(fmt::format("{} views are few: take {} or more, better 20",
                                        solution.views.size(), kGoodViews));
  }
  if (result.blur_px > 1.5)
    result.advice.push_back(fmt::format(
        "images are blurred ({:.1f} px): hold still, focus, more light", result.blur_px));
  // Warns if a lens that is non-monotonic in the image explains the views better: the chosen lens
  // must then have errors.
  std::string non_monotonic;
  for (const ModelTrial& trial : result.trials) {
    if (!trial.non_monotonic_px || !non_monotonic.empty() || !trial.held_out_px ||
        !result.held_out_px || *trial.held_out_px >= kMaxHeldOutRatio * *result.held_out_px)
      continue;
    non_monotonic = fmt::format(
        "{} explains the views better ({:.3f} px), but was not taken, since it is non-monotonic "
        "near the {}, where too few corners were seen: take views there",
        lens_name(trial), *trial.held_out_px, cells.name(cells.at(*trial.non_monotonic_px)));
    result.advice.push_back(non_monotonic);
  }
  if (solution.shape != BoardShape::rigid)
    result.advice.emplace_back(
        "the target is not flat, or printed inaccurately: glue it on glass or a board");

  const double error = result.held_out_px.value_or(solution.rms_px);
  const double sigma = result.uncertainty.largest_px;
  const bool finite = std::isfinite(sigma) && std::isfinite(error) && non_monotonic.empty();
  result.grade = finite && sigma <= kGoodProjection_px && error <= 1.0 ? CalibrationGrade::good
                 : finite && sigma <= 2.0 && error <= 2.0              ? CalibrationGrade::usable
                                                                       : CalibrationGrade::poor;
  const std::string worst = std::isfinite(sigma) ? worst_cell_name(result.uncertainty, cells) : "";
  std::string text = fmt::format(
      "{}: the lens is known to {:.2f} px (1 sigma) at the worst place in the image{}, {:.2f} "
      "on average; {} are explained to {:.2f} px",
      to_string(result.grade), sigma, worst.empty() ? "" : fmt::format(" ({})", worst),
      result.uncertainty.mean_px,
      result.held_out_px ? "held-out views" : "the views (none held out)", error);
  if (result.grade != CalibrationGrade::good) {
    if (error > 1.0)
      result.advice.emplace_back(
          "the corners are off by too much: is the target flat, the focus fixed?");
    // There is no other likely cause.
    if (!(sigma <= kGoodProjection_px) && !has_gaps && result.tilt_spread_deg >= kGoodTilt_deg) {
      result.advice.push_back(
          fmt::format("take more views: from near, so that the target fills the image, tilted to "
                      "every side{}",
                      worst.empty() ? std::string() : ", and near " + worst));
    }
    if (!result.advice.empty()) text += fmt::format("; {}", fmt::join(result.advice, "; "));
  } else if (!result.target_differences.empty()) {
    text += fmt::format("; {}", fmt::join(result.target_differences, "; "));
  } else if (has_gaps || result.other_board) {
    text += fmt::format("; {}", result.advice.front());
  }
  result.verdict = text;
}

}  // namespace penumbra
