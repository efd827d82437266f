// Calibrates a camera from images of a target: chooses views and a lens, estimates the uncertainty,
// and gives a verdict in words.
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
#include "calib/target/target.hpp"
#include "calib/target/target_detector.hpp"
#include "tracking/alignment/tone_estimator.hpp"
#include "tracking/detection/image_check.hpp"

namespace penumbra {

struct CalibrationOptions {
  std::optional<DistortionModel> model;  // else chosen by cross-validation
  std::optional<BoardShape> shape;       // else chosen by cross-validation
  // Only lenses that Kalibr's files have: plumb_bob without k3, and fisheye.
  bool for_kalibr = false;
  int most_views = 60;  // of more, the most different ones are solved; twice as many stay in memory
};

enum class PictureRejection { no, unreadable, not_seen, seen_before, blurred, surplus };

struct CalibrationPicture {
  std::string name;
  TargetView view;  // without corners if it was seen before or is surplus
  PictureRejection reason = PictureRejection::no;
  std::string left_out;            // the reason in words; empty if used
  int solved = -1;                 // index into CalibrationSolution::views; -1 if not used
  int width = 0;                   // [px]
  int height = 0;                  // [px]
  std::vector<std::uint8_t> luma;  // rows of `width` bytes; empty if it was rejected early
  [[nodiscard]] ImageView picture() const {
    return {luma.data(), luma.empty() ? 0 : width, height, width};
  }
};

// Selects the unused pictures to report, by picture: if a reason has more than `most` pictures,
// only the first, with the number of others that it stands for.
[[nodiscard]] std::vector<std::optional<int>> pictures_to_report(
    std::span<const CalibrationPicture> pictures, int most);

// Standard deviation of the projection over the image [px], along its worst direction.
struct UncertaintyMap {
  int columns = 0;
  int rows = 0;
  std::vector<double> sigma_px;  // row by row, at the centres of equal cells; NaN where unreachable
  // Both infinite for a lens with non-monotonic distortion in the image.
  double mean_px = 0.0;
  double largest_px = 0.0;
};
// Largest uncertainty of a good lens.
inline constexpr double kGoodProjection_px = 0.5;
[[nodiscard]] UncertaintyMap uncertainty_map(const CameraModel& camera,
                                             const Eigen::MatrixXd& covariance, int columns = 32,
                                             int rows = 24);

// Raises the map to the difference to another camera that explains the views as well
// (docs/calibration.md#verdict).
void raise_to_difference(UncertaintyMap& map, const CameraModel& camera, const CameraModel& other,
                         std::span<const CalibrationPicture> pictures);

// Distance between two cameras' projections over the first one's image, without fitting a rotation.
struct ProjectionDifference {
  double mean_px = 0.0;
  double largest_px = 0.0;
  double skipped = 0.0;  // share of the image that one of them does not reach
};
[[nodiscard]] ProjectionDifference projection_difference(const CameraModel& a,
                                                         const CameraModel& b);

// Relative size error of the tags' black squares (0.01: 1 % larger than the target file says), from
// their sizes [px] and edge shifts [px] in the views; nothing if it is small or not significant.
// See docs/calibration.md#tag-size.
[[nodiscard]] std::optional<double> tag_size_error_of(std::span<const double> sizes_px,
                                                      std::span<const double> shifts_px);

enum class CalibrationGrade { good, usable, poor };
[[nodiscard]] std::string_view to_string(CalibrationGrade grade);

struct CameraCalibration {
  CalibrationSolution solution;
  std::vector<CalibrationPicture> pictures;
  std::vector<ModelTrial> trials;
  std::optional<double> held_out_px;
  // Advice if most images show a chessboard of another size than the target file has.
  std::optional<std::string> other_board;
  UncertaintyMap uncertainty;
  std::optional<TableVolumeUncertainty> table;
  std::optional<ToneEstimate> tone;  // of targets with tags; the solution's camera has the exponent
  std::string tone_unknown;          // why there is none
  double tilt_spread_deg = 0.0;
  double blur_px = 0.0;  // median of the used views
  CalibrationGrade grade = CalibrationGrade::poor;
  std::string verdict;              // one line: the grade, why, and what to do
  std::vector<std::string> advice;  // "no views near the top left", ...
};

// Fills in the uncertainty, grade, advice and verdict from the rest (docs/calibration.md#verdict).
void judge(CameraCalibration& calibration);

class CameraCalibrator {
 public:
  [[nodiscard]] static Result<CameraCalibrator> create(const Target& target,
                                                       const CalibrationOptions& options = {});

  // Searches an image for the target. Fails if the image's size differs from that of the others.
  // Images with mirrored or negative tags are not used; CalibrationPicture::left_out says so.
  [[nodiscard]] Result<void> add(const std::string& name, ImageView luma);
  void add_unreadable(const std::string& name, const std::string& why);
  // Images in memory; at most twice as many as the views to solve.
  [[nodiscard]] std::ptrdiff_t images_in_memory() const;

  // Solves, once. An error is one line that says what the pictures lack. Fails soon after `stop`
  // was requested. Calls `tell` on this thread at each step.
  [[nodiscard]] Result<CameraCalibration> finish(std::stop_token stop = {},
                                                 const StepCallback& tell = {});

 private:
  CameraCalibrator() = default;
  [[nodiscard]] std::string problem_of(const TargetView& view, ImageView luma);
  // Searches for a chessboard of any size, in at most `most_images`: it takes a tenth of a second.
  void look_for_board(ImageView luma, int most_images);
  // Names the size that most images show, if it is not the target file's.
  [[nodiscard]] std::optional<std::string> other_board_in_words() const;
  [[nodiscard]] Result<void> check_found() const;
  [[nodiscard]] Result<void> check_markers() const;
  void reject_blurred();
  void reject_surplus();
  void reject(CalibrationPicture& picture, PictureRejection reason, std::string words);
  [[nodiscard]] std::vector<CalibrationView> used_views();
  void refine_corners(const CalibrationSolution& solution);
  [[nodiscard]] Result<void> check_solution(const CalibrationSolution& solution,
                                            const std::vector<CalibrationView>& views) const;
  [[nodiscard]] Result<ToneEstimate> estimate_tone(CameraCalibration& result) const;

  Target target_;
  CalibrationOptions options_;
  std::optional<TargetDetector> detector_;
  std::optional<ImageCheck> check_;  // of targets with tags
  bool some_faulty_ = false;         // an image was mirrored or negative
  std::vector<CalibrationPicture> pictures_;
  int width_ = 0;
  int height_ = 0;
  std::string first_;   // picture that set the size
  int seen_in_ = 0;     // pictures with a corner of the target
  int wide_in_ = 0;     // ... whose tags mostly have a border of two cells
  int candidates_ = 0;  // pictures that are still in use
  // Sizes of chessboards in some images.
  std::vector<std::array<int, 2>> boards_seen_;
  int searched_for_boards_ = 0;
  std::stop_token stop_;
};

}  // namespace penumbra
