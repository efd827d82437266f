// Calibrates a camera from images of a target: selects views, chooses a lens model, estimates its
// uncertainty and grades the result.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/solver/intrinsics_solver.hpp"
#include "calib/solver/lens_choice.hpp"
#include "calib/solver/table_volume.hpp"
#include "calib/target/tag_census.hpp"
#include "calib/target/target.hpp"
#include "calib/target/target_detector.hpp"
#include "calib/target/target_motion.hpp"
#include "core/camera/camera_file.hpp"
#include "tracking/alignment/tone_estimator.hpp"
#include "tracking/detection/image_check.hpp"

namespace penumbra {

struct CalibrationOptions {
  std::optional<DistortionModel> model;  // else chosen by cross-validation
  std::optional<BoardShape> shape;       // else chosen by cross-validation
  // Considers only lenses that Kalibr's files can represent: plumb_bob without k3, and fisheye.
  bool for_kalibr = false;
  int max_views = 60;  // solves the most different ones; memory holds twice this number
};

enum class ImageRejection { no, unreadable, not_seen, seen_before, blurred, surplus };

struct CalibrationImage {
  std::string name;
  TargetView view;  // without corners for `seen_before` and `surplus`
  ImageRejection reason = ImageRejection::no;
  std::string left_out;            // the reason in words; empty if used
  int solved = -1;                 // index into CalibrationSolution::views; -1 if not used
  int width = 0;                   // [px]
  int height = 0;                  // [px]
  std::vector<std::uint8_t> luma;  // rows of `width` bytes; empty if it was rejected early
  [[nodiscard]] ImageView image() const {
    return {luma.data(), luma.empty() ? 0 : width, height, width};
  }
};

// Selects the unused images to report: all images of a reason, or only the first if there are more
// than `limit`. Value: number of other images that the image represents; nullopt: not selected.
[[nodiscard]] std::vector<std::optional<int>> images_to_report(
    std::span<const CalibrationImage> images, int limit);

// Projection uncertainty over the image: standard deviation along the worst direction [px].
struct UncertaintyMap {
  int columns = 0;
  int rows = 0;
  std::vector<double> sigma_px;  // row by row, at the centres of equal cells; NaN without a ray
  // mean_px and largest_px are infinite if the distortion is non-monotonic in the image.
  double mean_px = 0.0;
  double largest_px = 0.0;
};
// Maximum projection uncertainty of a lens with the grade "good".
inline constexpr double kGoodProjection_px = 0.5;
[[nodiscard]] UncertaintyMap uncertainty_map(const CameraModel& camera,
                                             const Eigen::MatrixXd& covariance, int columns = 32,
                                             int rows = 24);

// Raises the map to the difference from another camera that explains the views equally well
// (docs/calibration.md#verdict).
void raise_to_difference(UncertaintyMap& map, const CameraModel& camera, const CameraModel& other,
                         std::span<const CalibrationImage> images);

// Distance between the projections of two cameras over the image of `a`. No rotation is fitted.
struct ProjectionDifference {
  double mean_px = 0.0;
  double largest_px = 0.0;
  double skipped = 0.0;  // fraction of the image where one camera has no ray
};
[[nodiscard]] ProjectionDifference projection_difference(const CameraModel& a,
                                                         const CameraModel& b);

// Estimates the relative size error of the tags' black squares (0.01: 1 % larger than in the target
// file) from their sizes and edge shifts in the views [px]. Returns nullopt if the error is small
// or not significant. See docs/calibration.md#tag-size.
[[nodiscard]] std::optional<double> tag_size_error_of(std::span<const double> sizes_px,
                                                      std::span<const double> shifts_px);

// Fails if the views differ too little in tilt.
[[nodiscard]] Result<void> check_tilt(const CalibrationSolution& solution);
// Fails if the focal length is determined to 20 % or worse.
[[nodiscard]] Result<void> check_focal_length(const CalibrationSolution& solution);

enum class CalibrationGrade { good, usable, poor };
[[nodiscard]] std::string_view to_string(CalibrationGrade grade);

struct CameraCalibration {
  CalibrationSolution solution;
  std::vector<CalibrationImage> images;
  std::vector<ModelTrial> trials;
  std::optional<double> held_out_px;  // RMS error in held-out views
  // Advice to users if most images show a chessboard with other numbers of corners.
  std::optional<std::string> other_board;
  // Lines about tags in the images that the target file does not have, and the reverse.
  std::vector<std::string> target_differences;
  UncertaintyMap uncertainty;
  std::optional<TableVolumeUncertainty> table;
  std::optional<ToneEstimate> tone;  // for targets with tags; also set in solution.camera
  std::string tone_unknown;          // why `tone` is empty
  std::optional<RowTime> row_time;   // if the images show one; also set in solution.camera
  double tilt_spread_deg = 0.0;
  double blur_px = 0.0;  // median of the used views
  CalibrationGrade grade = CalibrationGrade::poor;
  std::string verdict;              // one line: the grade, why, and what to do
  std::vector<std::string> advice;  // "no views near the top left", ...
};

// Sets uncertainty, grade, advice and verdict from the other members (docs/calibration.md#verdict).
void judge(CameraCalibration& calibration);

// Returns the record for the camera file. `date`: "2026-03-01". `focus_position`: of the camera's
// focus control.
[[nodiscard]] CalibrationRecord record_of(const CameraCalibration& calibration,
                                          const Target& target, const std::string& date,
                                          std::optional<double> focus_position = std::nullopt);

class CameraCalibrator {
 public:
  [[nodiscard]] static Result<CameraCalibrator> create(const Target& target,
                                                       const CalibrationOptions& options = {});

  // Searches an image for the target. Fails if its size differs from the other images' size.
  // Rejects images with mirrored or negative tags (CalibrationImage::left_out). `timestamp_ns`: if
  // the images are of a video.
  [[nodiscard]] Result<void> add(const std::string& name, ImageView luma,
                                 std::optional<std::int64_t> timestamp_ns = std::nullopt);
  // Adds corners of an image of a video that is not a view, to estimate the row time.
  void add_motion(std::int64_t timestamp_ns, std::span<const TargetCorner> corners) {
    motion_->add(timestamp_ns, corners);
  }
  void add_unreadable(const std::string& name, const std::string& why);
  // Returns the number of images in memory: up to 2 * CalibrationOptions::max_views.
  [[nodiscard]] std::ptrdiff_t images_in_memory() const;

  // Calibrates; call it once. The error is one line that explains what the images lack. Fails soon
  // after `stop` was requested. Calls the callback on this thread at each step.
  [[nodiscard]] Result<CameraCalibration> finish(std::stop_token stop = {},
                                                 const StepCallback& on_step = {});

 private:
  CameraCalibrator() = default;
  [[nodiscard]] Result<CameraCalibration> solve(const StepCallback& on_step);
  [[nodiscard]] std::string problem_of(const TargetView& view, ImageView luma);
  // Searches for a chessboard of any size, in a limited number of images: each takes 0.1 s.
  void detect_any_board(ImageView luma, int max_images);
  // Returns advice if the chessboard size in most images differs from the target file.
  [[nodiscard]] std::optional<std::string> other_board_advice() const;
  [[nodiscard]] Result<void> check_found() const;
  [[nodiscard]] Result<void> check_markers() const;
  void reject_blurred();
  void reject_surplus();
  void reject(CalibrationImage& image, ImageRejection reason, std::string words);
  [[nodiscard]] std::vector<CalibrationView> used_views();
  void refine_corners(const CalibrationSolution& solution);
  [[nodiscard]] Result<void> check_solution(const CalibrationSolution& solution,
                                            const std::vector<CalibrationView>& views) const;
  [[nodiscard]] Result<ToneEstimate> estimate_tone(CameraCalibration& result) const;

  Target target_;
  CalibrationOptions options_;
  std::optional<TargetDetector> detector_;
  std::optional<ImageCheck> check_;  // for targets with tags
  std::optional<TagCensus> census_;  // for targets with tags
  std::optional<TargetMotion> motion_;
  bool found_faulty_image_ = false;  // an image was mirrored or negative
  std::vector<CalibrationImage> images_;
  int width_ = 0;
  int height_ = 0;
  std::string first_name_;         // name of the first image, which sets the size
  int images_with_target_ = 0;     // images with a corner of the target
  int images_with_wide_tags_ = 0;  // images in which most tags have a border of two cells
  int candidates_ = 0;             // images that are not rejected
  // Sizes of the chessboards that detect_any_board() found.
  std::vector<std::array<int, 2>> board_sizes_;
  int board_searches_ = 0;
  std::stop_token stop_;
};

}  // namespace penumbra
