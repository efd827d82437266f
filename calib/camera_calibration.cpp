#include "calib/camera_calibration.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "core/propagate.hpp"
#include "core/statistics.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMinViews = 3;
constexpr double kMinTilt_deg = 8.0;  // below it, focal length and distance are ambiguous
// Edge shifts caused by camera response, blur and ink do not exceed both limits. A larger shift
// means that the black squares have another size than in the target file.
constexpr double kMaxSizeError = 0.04;  // fraction of the size
constexpr double kMaxEdgeShift_px = 0.8;
// A slope of edge shift over size above both limits also means another size.
constexpr double kMaxShiftSlope = 0.012;
constexpr double kSignificantSigmas = 5.0;

// Like tag_size_error_of(), but also detects a shift that is too large in most views.
std::optional<double> tag_size_error(const CalibrationSolution& solution,
                                     const std::vector<CalibrationView>& views) {
  std::vector<double> relative_errors;
  std::vector<double> shifts;
  std::vector<double> tag_sizes;
  for (std::size_t v = 0; v < views.size(); ++v) {
    std::vector<double> sizes;
    for (std::size_t c = 1; c < views[v].corners.size(); ++c) {
      const TargetCorner& before = views[v].corners[c - 1];
      const TargetCorner& corner = views[v].corners[c];
      if (corner.point / 4 == before.point / 4)
        sizes.push_back((corner.pixel - before.pixel).norm());
    }
    if (sizes.empty()) continue;
    tag_sizes.push_back(upper_median(std::move(sizes)));
    shifts.push_back(solution.views[v].edge_shift_px);
    relative_errors.push_back(2.0 * shifts.back() / tag_sizes.back());
  }
  if (const auto error = tag_size_error_of(tag_sizes, shifts)) return error;
  const double error = upper_median(std::move(relative_errors));
  if (std::abs(error) > kMaxSizeError &&
      std::abs(upper_median(std::move(shifts))) > kMaxEdgeShift_px)
    return error;
  return std::nullopt;
}

}  // namespace

std::optional<double> tag_size_error_of(std::span<const double> sizes_px,
                                        std::span<const double> shifts_px) {
  const std::size_t n = sizes_px.size();
  if (n < 6 || shifts_px.size() != n) return std::nullopt;
  double mean_size = 0.0;
  double mean_shift = 0.0;
  for (std::size_t v = 0; v < n; ++v) {
    mean_size += sizes_px[v] / static_cast<double>(n);
    mean_shift += shifts_px[v] / static_cast<double>(n);
  }
  double squares = 0.0;
  double products = 0.0;
  for (std::size_t v = 0; v < n; ++v) {
    squares += (sizes_px[v] - mean_size) * (sizes_px[v] - mean_size);
    products += (sizes_px[v] - mean_size) * (shifts_px[v] - mean_shift);
  }
  const double slope = products / squares;
  double squared_residuals = 0.0;
  for (std::size_t v = 0; v < n; ++v) {
    const double residual = shifts_px[v] - mean_shift - slope * (sizes_px[v] - mean_size);
    squared_residuals += residual * residual;
  }
  const double error = std::sqrt(squared_residuals / static_cast<double>(n - 2) / squares);
  // A square has two edges, which shift in opposite directions.
  if (!std::isfinite(slope) || std::abs(2.0 * slope) <= kMaxShiftSlope ||
      std::abs(slope) <= kSignificantSigmas * error)
    return std::nullopt;
  return 2.0 * slope;
}

std::vector<std::optional<int>> images_to_report(std::span<const CalibrationImage> images,
                                                 int limit) {
  std::map<ImageRejection, int> count;
  for (const CalibrationImage& image : images) ++count[image.reason];
  std::vector<std::optional<int>> reported(images.size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    const ImageRejection reason = images[i].reason;
    if (reason == ImageRejection::no || count[reason] == 0) continue;
    const bool many = count[reason] > limit;
    reported[i] = many ? count[reason] - 1 : 0;
    if (many) count[reason] = 0;
  }
  return reported;
}

Result<CameraCalibrator> CameraCalibrator::create(const Target& target,
                                                  const CalibrationOptions& options) {
  CameraCalibrator self;
  self.target_ = target;
  self.options_ = options;
  PENUMBRA_TRY(self.detector_, TargetDetector::create(target));
  self.motion_.emplace(target);
  if (target.tags) {
    PENUMBRA_TRY(self.check_, ImageCheck::create(*target.tags));
    self.census_.emplace(*target.tags);
  }
  return self;
}

Result<void> CameraCalibrator::add(const std::string& name, ImageView luma,
                                   std::optional<std::int64_t> timestamp_ns) {
  if (first_name_.empty()) {
    first_name_ = name;
    width_ = luma.width;
    height_ = luma.height;
  } else if (luma.width != width_ || luma.height != height_) {
    return fail("{}: is {} x {} px, but {} is {} x {}; give images of one camera and one size",
                name, luma.width, luma.height, first_name_, width_, height_);
  }
  CalibrationImage image;
  image.name = name;
  image.width = luma.width;
  image.height = luma.height;
  image.view = detector_->detect(luma);
  if (census_) census_->add(image.view.tags, luma);
  if (timestamp_ns) motion_->add(*timestamp_ns, image.view.corners);
  ++candidates_;
  if (!image.view.corners.empty()) ++images_with_target_;
  if (4 * image.view.two_cell_tags > static_cast<int>(image.view.corners.size()))
    ++images_with_wide_tags_;
  if (!image.view.problem.empty()) {
    constexpr int kMaxImages = 8;
    detect_any_board(luma, kMaxImages);
    reject(image, ImageRejection::not_seen, problem_of(image.view, luma));
  }
  if (image.left_out.empty()) {
    // A repeated view would count its errors twice. A hand's tremor exceeds this limit.
    const double min_distance_px = 0.002 * width_;
    for (const CalibrationImage& other : images_) {
      if (!other.left_out.empty() ||
          corner_distance(image.view.corners, other.view.corners) > min_distance_px)
        continue;
      reject(image, ImageRejection::seen_before, fmt::format("the same view as {}", other.name));
      break;
    }
  }
  if (image.left_out.empty()) {
    image.luma.reserve(static_cast<std::size_t>(luma.width) *
                       static_cast<std::size_t>(luma.height));
    for (int y = 0; y < luma.height; ++y)
      image.luma.insert(image.luma.end(), luma.row(y), luma.row(y) + luma.width);
  }
  images_.push_back(std::move(image));
  // Frees images, because long recordings do not fit into memory.
  if (candidates_ > 2 * options_.max_views) {
    reject_blurred();
    reject_surplus();
    for (CalibrationImage& other : images_) {
      if (other.reason != ImageRejection::no) other.luma = std::vector<std::uint8_t>();
    }
  }
  return {};
}

std::ptrdiff_t CameraCalibrator::images_in_memory() const {
  return std::ranges::count_if(images_, [](const auto& p) { return p.luma.capacity() > 0; });
}

// Describes why the target is not found in an image. The image may be mirrored or negative.
std::string CameraCalibrator::problem_of(const TargetView& view, ImageView luma) {
  if (!check_ || !view.corners.empty() || view.two_cell_tags > 0) return view.problem;
  // After one mirrored or negative image, checks every image.
  const auto fault = found_faulty_image_ ? check_->find_fault(luma) : check_->check_untagged(luma);
  if (!fault) return view.problem;
  found_faulty_image_ = true;
  return std::string(advice(*fault));
}

void CameraCalibrator::detect_any_board(ImageView luma, int max_images) {
  if (target_.kind != TargetKind::chessboard || board_searches_ >= max_images) return;
  ++board_searches_;
  if (const auto size = chessboard_size(luma)) board_sizes_.push_back(*size);
}

// Requires several images with the same board size, because a board may be clipped or misdetected.
std::optional<std::string> CameraCalibrator::other_board_advice() const {
  constexpr int kMinImages = 3;
  std::map<std::array<int, 2>, int> counts;
  for (const std::array<int, 2>& size : board_sizes_) ++counts[size];
  const auto mode = std::ranges::max_element(counts, {}, [](const auto& c) { return c.second; });
  const std::array target_size = {std::max(target_.columns, target_.rows),
                                  std::min(target_.columns, target_.rows)};
  if (mode == counts.end() || mode->second < kMinImages || mode->first == target_size)
    return std::nullopt;
  const bool larger = mode->first[0] > target_size[0] || mode->first[1] > target_size[1];
  if (!larger && 2 * mode->second < static_cast<int>(board_sizes_.size())) return std::nullopt;
  return fmt::format(
      "{} images show a chessboard of {} x {} inner corners, but the target file says {} x {}: "
      "correct the target file, or show the whole board",
      mode->second, mode->first[0], mode->first[1], target_.columns, target_.rows);
}

void CameraCalibrator::reject(CalibrationImage& image, ImageRejection reason, std::string words) {
  image.reason = reason;
  image.left_out = std::move(words);
  --candidates_;
  if (reason != ImageRejection::seen_before && reason != ImageRejection::surplus) return;
  // Frees the memory; `= {}` would not.
  image.view.corners = std::vector<TargetCorner>();
  image.luma = std::vector<std::uint8_t>();
}

void CameraCalibrator::add_unreadable(const std::string& name, const std::string& why) {
  CalibrationImage image;
  image.name = name;
  image.reason = ImageRejection::unreadable;
  image.left_out = why;
  images_.push_back(std::move(image));
}

Result<void> CameraCalibrator::check_found() const {
  if (images_.empty()) return fail("there are no images");
  std::map<std::string, int> reasons;
  for (const CalibrationImage& image : images_) {
    if (image.reason == ImageRejection::seen_before) {
      ++reasons["the same view as another"];
    } else if (image.reason != ImageRejection::no) {
      ++reasons[image.left_out];
    }
  }
  const int usable = candidates_;
  if (images_with_wide_tags_ > usable) {
    return fail(
        "in {} of {} images the tags have a black border of two cells, as Kalibr prints them; "
        "libapriltag, which finds tags here and while tracking, reads borders of one cell: print a "
        "sheet with penumbra target",
        images_with_wide_tags_, images_.size());
  }
  const auto mode =
      std::ranges::max_element(reasons, {}, [](const auto& reason) { return reason.second; });
  const std::string because = mode == reasons.end()
                                  ? ""
                                  : fmt::format(" ({} time{}: {})", mode->second,
                                                mode->second == 1 ? "" : "s", mode->first);
  if (std::ranges::all_of(images_, [](const auto& image) { return image.width == 0; })) {
    return fail("none of {} images can be read ({})", images_.size(), images_.front().left_out);
  }
  const bool too_few = usable < static_cast<int>(kMinViews);
  if (too_few) {
    if (const auto other_board = other_board_advice()) return fail("{}", *other_board);
  }
  if (images_with_target_ == 0) {
    if (found_faulty_image_) {
      return fail("the target ({}) is in none of {} images as they are{}", target_.description,
                  images_.size(), because);
    }
    const bool has_others = census_ && !census_->differences().empty();
    return fail("the target ({}) is in none of {} images{}{}", target_.description, images_.size(),
                because, has_others ? "" : "; is it the right target file?");
  }
  if (!too_few) return {};
  if (usable == static_cast<int>(images_.size())) {
    return fail(
        "{} image{} too few, a camera needs at least 3; take 20, with the target tilted in "
        "several directions and in every part of the image",
        usable, usable == 1 ? " is" : "s are");
  }
  // A board with other numbers of corners fails like one that is clipped or occluded.
  const std::string count =
      target_.kind == TargetKind::chessboard
          ? fmt::format("; has it {} x {} inner corners? If so,", target_.columns, target_.rows)
          : ";";
  return fail(
      "only {} of {} images can be used{}, and a camera needs at least 3{} take 20, with the "
      "target tilted in several directions and in every part of the image",
      usable, images_.size(), because, count);
}

// Fails if the markers' size differs from the target file. The lens would be correct, but not the
// poses in a session that tracks the markers.
Result<void> CameraCalibrator::check_markers() const {
  if (target_.kind != TargetKind::charuco) return {};
  std::vector<double> shares;
  std::vector<double> edges_px;
  for (const CalibrationImage& image : images_) {
    if (!image.left_out.empty() || !image.view.markers) continue;
    shares.push_back(image.view.markers->share);
    edges_px.push_back(image.view.markers->edge_px);
  }
  if (shares.empty()) return {};
  const double nominal = target_.tags->tags().front().size_m / target_.square_m;
  const double seen = upper_median(shares);
  if (std::abs(seen / nominal - 1.0) <= kMaxSizeError ||
      std::abs(upper_median(edges_px)) <= kMaxEdgeShift_px)
    return {};
  return fail(
      "the markers are {:.3f} of a square wide, but the target file says {:.3f}; measure tag_m and "
      "square_m again, and count columns and rows",
      seen, nominal);
}

void CameraCalibrator::reject_blurred() {
  std::vector<double> blurs;
  for (const CalibrationImage& image : images_) {
    if (image.left_out.empty() && image.view.blur_px > 0.0) blurs.push_back(image.view.blur_px);
  }
  if (blurs.size() < 6) return;
  const double limit = std::max(2.0 * upper_median(blurs), 1.5);
  for (CalibrationImage& image : images_) {
    if (!image.left_out.empty() || image.view.blur_px <= limit || candidates_ <= 4) continue;
    reject(image, ImageRejection::blurred,
           fmt::format("blurred: edges are {:.1f} px wide (sigma), {:.1f} in most views",
                       image.view.blur_px, upper_median(blurs)));
  }
}

// Selects the most different views: each next view is the furthest from those already selected.
void CameraCalibrator::reject_surplus() {
  if (candidates_ <= options_.max_views) return;
  std::vector<std::size_t> at;
  for (std::size_t i = 0; i < images_.size(); ++i) {
    if (images_[i].left_out.empty()) at.push_back(i);
  }
  const double largest = 10.0 * width_;
  std::vector<double> distance(at.size(), largest);
  std::vector<bool> chosen(at.size(), false);
  std::size_t next = 0;
  for (int n = 0; n < options_.max_views; ++n) {
    chosen[next] = true;
    std::size_t furthest = next;
    double best_worth = -1.0;
    for (std::size_t i = 0; i < at.size(); ++i) {
      distance[i] = std::min(distance[i], corner_distance(images_[at[i]].view.corners,
                                                          images_[at[next]].view.corners));
      // Views with more corners get a higher weight.
      const double worth =
          distance[i] * std::sqrt(static_cast<double>(images_[at[i]].view.corners.size()));
      if (!chosen[i] && worth > best_worth) {
        best_worth = worth;
        furthest = i;
      }
    }
    next = furthest;
  }
  for (std::size_t i = 0; i < at.size(); ++i) {
    if (!chosen[i])
      reject(images_[at[i]], ImageRejection::surplus, "much like others: enough views");
  }
}

std::vector<CalibrationView> CameraCalibrator::used_views() {
  std::vector<CalibrationView> views;
  for (CalibrationImage& image : images_) {
    image.solved = -1;
    if (!image.left_out.empty()) continue;
    image.solved = static_cast<int>(views.size());
    views.push_back({image.name, image.view.corners});
  }
  return views;
}

void CameraCalibrator::refine_corners(const CalibrationSolution& solution) {
  for (CalibrationImage& image : images_) {
    if (stop_.stop_requested()) return;
    if (image.solved < 0) continue;
    image.view =
        detector_->refine(image.image(), image.view, solution.camera,
                          solution.views[static_cast<std::size_t>(image.solved)].T_board_camera);
  }
}

Result<void> check_tilt(const CalibrationSolution& solution) {
  const double tilt = degrees(tilt_spread(solution.views));
  if (tilt >= kMinTilt_deg) return {};
  return fail(
      "all {} views show the target parallel to one plane (within {:.1f} degrees), so focal "
      "length and distance can't be separated; tilt the target by 30 to 45 degrees in several "
      "directions",
      solution.views.size(), tilt);
}

Result<void> check_focal_length(const CalibrationSolution& solution) {
  const double sigma_f = std::sqrt(solution.covariance(0, 0)) / solution.camera.parameters().fx;
  if (sigma_f < 0.2) return {};
  return fail(
      "the views determine the focal length only to {:.0f} %; tilt the target by 30 to 45 "
      "degrees in several directions",
      sigma_f * 100.0);
}

Result<void> CameraCalibrator::check_solution(const CalibrationSolution& solution,
                                              const std::vector<CalibrationView>& views) const {
  PENUMBRA_TRY_VOID(check_tilt(solution));
  if (solution.contradicts_corners()) {
    if (const auto other_board = other_board_advice()) return fail("{}", *other_board);
    return fail(
        "no camera explains the corners: they are off by {:.1f} px, {} of {} outliers; does the "
        "target file say what is printed (tag size, spacing, squares), and is it one camera with "
        "one focus?",
        solution.rms_all_px, solution.outliers, solution.corners);
  }
  if (target_.kind == TargetKind::tags) {
    if (const auto share = tag_size_error(solution, views)) {
      // `share` is relative to the size in the image.
      return fail(
          "the tags' black squares are {:.1f} % {} than the target file says, for the distances "
          "between them; measure tag size and spacing again",
          std::abs(*share / (1.0 - *share)) * 100.0, *share > 0.0 ? "larger" : "smaller");
    }
  }
  return check_focal_length(solution);
}

// Estimates the camera response from the tags' edges, for the solved lens and poses. The solved
// lens does not depend on the response, because the solver fits an edge shift in each view.
Result<ToneEstimate> CameraCalibrator::estimate_tone(CameraCalibration& result) const {
  if (!target_.tags) return fail("a chessboard's corners do not show it, tags do");
  PENUMBRA_TRY(ToneEstimator estimator,
               ToneEstimator::create(result.solution.camera, target_.tags->tags()));
  for (const CalibrationImage& image : result.images) {
    if (stop_.stop_requested()) return fail("ended early");
    if (image.solved < 0) continue;
    const SolvedView& view = result.solution.views[static_cast<std::size_t>(image.solved)];
    estimator.add(image.image(), view.T_board_camera);
  }
  PENUMBRA_TRY(const ToneEstimate tone, estimator.estimate());
  CameraParameters parameters = result.solution.camera.parameters();
  parameters.tone_curve = tone.exponent;
  PENUMBRA_TRY(result.solution.camera, CameraModel::make(parameters));
  return tone;
}

Result<CameraCalibration> CameraCalibrator::finish(std::stop_token stop,
                                                   const StepCallback& on_step) {
  stop_ = std::move(stop);
  auto result = solve(on_step);
  const auto differences = census_ ? census_->differences() : std::vector<std::string>();
  if (result || differences.empty() || stop_.stop_requested()) return result;
  const std::string& cause = result.error().message;
  return fail("{}{} {}", cause, cause.ends_with('?') ? "" : ";", fmt::join(differences, "; "));
}

Result<CameraCalibration> CameraCalibrator::solve(const StepCallback& on_step) {
  PENUMBRA_TRY_VOID(check_found());
  PENUMBRA_TRY_VOID(check_markers());
  reject_blurred();
  reject_surplus();
  std::vector<CalibrationView> views = used_views();
  if (board_searches_ > 0) {
    // A part of a larger board may have been detected as the target.
    constexpr int kMaxImages = 12;
    for (const CalibrationImage& image : images_) {
      if (image.left_out.empty()) detect_any_board(image.image(), kMaxImages);
    }
  }
  constexpr int kBefore = 3;  // steps before the lens choice
  constexpr int kAfter = 1;   // steps after the lens choice
  LensChoice choice = {options_.model, options_.for_kalibr, stop_, {}};
  int last = kBefore + max_steps(choice, options_.shape.has_value()) + kAfter;
  const auto report_step = [&](const char* what, int step) {
    if (on_step) on_step({what, step, last});
  };
  choice.on_step = [&](const SolvingStep& trial) {
    last = kBefore + trial.max_step + kAfter;
    if (on_step) on_step({trial.what, kBefore + trial.step, last});
  };
  report_step("a first lens", 1);
  PENUMBRA_TRY(CalibrationSolution solution,
               first_solution(width_, height_, target_.points, views, choice));
  PENUMBRA_TRY_VOID(check_solution(solution, views));
  // Refines twice, because the first corners were detected by straight lines in distorted images.
  for (int round = 0; round < 2; ++round) {
    report_step("corners, by the lens that is known", 2 + round);
    refine_corners(solution);
    views = used_views();
    const CameraParameters& lens = solution.camera.parameters();
    SolverOptions solver;
    solver.stop = stop_;
    solver.model = lens.model;
    solver.without_k3 = lens.model == DistortionModel::plumb_bob && lens.distortion[4] == 0.0;
    PENUMBRA_TRY(solution, solve_intrinsics(solution, target_.points, views, solver));
  }
  CameraCalibration result;
  Result<ChosenLens> chosen =
      choose_lens(solution, target_.points, views, choice, options_.shape, result.trials);
  if (stop_.stop_requested()) return fail("ended early");
  if (!chosen) return tl::unexpected(chosen.error());
  result.solution = std::move(chosen->solution);
  result.held_out_px = chosen->held_out_px;
  PENUMBRA_TRY_VOID(check_solution(result.solution, views));
  result.images = std::move(images_);
  result.other_board = other_board_advice();
  if (census_) result.target_differences = census_->differences();
  judge(result);
  report_step("row time and tone curve", last);
  result.row_time = motion_->row_time(result.solution.camera);
  if (result.row_time) {
    PENUMBRA_TRY(result.solution.camera,
                 with_row_time(result.solution.camera, result.row_time->seconds));
  }
  const Result<ToneEstimate> tone = estimate_tone(result);
  if (stop_.stop_requested()) return fail("ended early");
  if (tone) {
    result.tone = *tone;
  } else {
    result.tone_unknown = tone.error().message;
  }
  return result;
}

CalibrationRecord record_of(const CameraCalibration& calibration, const Target& target,
                            const std::string& date, std::optional<double> focus_position) {
  const CalibrationSolution& solution = calibration.solution;
  CalibrationRecord record;
  record.calibrated_on = date;
  record.target = target.description;
  record.views = static_cast<int>(solution.views.size());
  record.rms_px = solution.rms_px;
  record.held_out_px = calibration.held_out_px;
  record.projection_mean_px = calibration.uncertainty.mean_px;
  record.projection_largest_px = calibration.uncertainty.largest_px;
  if (const auto& table = calibration.table) {
    record.table_distance_m = table->distance_m;
    record.table_tracked_px.assign(table->tracked_px.begin(), table->tracked_px.end());
    record.table_known_pose_px.assign(table->known_pose_px.begin(), table->known_pose_px.end());
  }
  for (Eigen::Index i = 0; i < solution.covariance.rows(); ++i)
    record.standard_deviations.push_back(std::sqrt(std::max(solution.covariance(i, i), 0.0)));
  record.focus_position = focus_position;
  if (calibration.tone) record.tone_curve_sigma = calibration.tone->sigma;
  if (calibration.row_time) record.row_time_sigma_s = calibration.row_time->sigma_s;
  return record;
}

}  // namespace penumbra
