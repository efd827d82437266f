// Pictures of a target -> a camera that can be trusted, or what is missing: which views count,
// which lens explains them, what the result is worth, and a verdict in words.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
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

namespace penumbra {

struct CalibrationOptions {
  std::optional<DistortionModel> model;  // else chosen by cross-validation
  std::optional<BoardShape> shape;       // else chosen by cross-validation
  // Only lenses that Kalibr's files can say: plumb_bob without k3, and fisheye.
  bool for_kalibr = false;
  int most_views = 60;  // of more, those are taken that differ most
  // So many candidates are kept in memory, with their pictures; of more, those that are much like
  // others go before all have come. 0: twice most_views.
  int most_candidates = 0;
};

enum class LeftOut { no, unreadable, not_seen, seen_before, blurred, surplus };

// One picture, used or not.
struct CalibrationPicture {
  std::string name;
  TargetView view;  // without corners where it was seen before or is surplus
  LeftOut reason = LeftOut::no;
  std::string left_out;            // the reason in words; empty when used
  int solved = -1;                 // index into CalibrationSolution::views; -1 when left out
  int width = 0;                   // [px]
  int height = 0;                  // [px]
  std::vector<std::uint8_t> luma;  // rows of `width` bytes; empty where it was left out early
  [[nodiscard]] ImageView picture() const {
    return {luma.data(), luma.empty() ? 0 : width, height, width};
  }
};

// Of every picture that was left out: whether it is told, and how many others it stands for, since
// of more than `most` with one reason only the first is. By picture; nothing for those not told.
[[nodiscard]] std::vector<std::optional<int>> told_left_out(
    std::span<const CalibrationPicture> pictures, int most);

// Standard deviation of the projection over the image [px], along its worst direction.
struct UncertaintyMap {
  int columns = 0;
  int rows = 0;
  std::vector<double> sigma_px;  // row by row, at the middles of equal cells; NaN where unreachable
  // Both infinite for a lens that folds in the image.
  double mean_px = 0.0;
  double largest_px = 0.0;
};
// A lens is good that is known so well everywhere in the image.
inline constexpr double kGoodProjection_px = 0.5;
[[nodiscard]] UncertaintyMap uncertainty_map(const CameraModel& camera,
                                             const Eigen::MatrixXd& covariance, int columns = 32,
                                             int rows = 24);

// Makes the map no smaller than the difference to another camera that explains the views as well.
// Where no corner was seen near, both are guessing: there it counts as much as where it differs
// most from what was seen, even where the two happen to meet.
void widen(UncertaintyMap& map, const CameraModel& camera, const CameraModel& other,
           std::span<const CalibrationPicture> pictures);

// How far two cameras' projections are from each other, over the first one's image: no rotation is
// fitted.
struct ProjectionDifference {
  double mean_px = 0.0;
  double largest_px = 0.0;
  double skipped = 0.0;  // share of the image that one of them does not describe
};
[[nodiscard]] ProjectionDifference projection_difference(const CameraModel& a,
                                                         const CameraModel& b);

// By which share of their size tags' black squares are larger than the target file says, from their
// size in views [px] and the edge shift that each view was solved with [px]: ink, blur and tone
// curve move edges by the same whatever the size, a wrong size moves them the further the larger
// the tags are in the picture. Nothing where that is no more than chance, or little.
[[nodiscard]] std::optional<double> other_size(std::span<const double> sizes_px,
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
  // Of targets with tags, where the pictures show it: the solution's camera has the exponent.
  std::optional<ToneEstimate> tone;
  std::string tone_unknown;  // why there is none
  double tilt_spread_deg = 0.0;
  double blur_px = 0.0;  // middle of the used views
  CalibrationGrade grade = CalibrationGrade::poor;
  std::string verdict;              // one line: the grade, why, and what to do
  std::vector<std::string> advice;  // "no views near the top left", ...
};

// What a solution is worth: fills in the uncertainty, grade, advice and verdict from the rest.
void judge(CameraCalibration& calibration);

class CameraCalibrator {
 public:
  [[nodiscard]] static Result<CameraCalibrator> create(const Target& target,
                                                       const CalibrationOptions& options = {});
  CameraCalibrator(CameraCalibrator&&) noexcept;
  CameraCalibrator& operator=(CameraCalibrator&&) noexcept;
  ~CameraCalibrator();

  // Looks for the target in an image. Fails if the image's size is not that of the others. Images
  // with mirrored or negative tags are not used; CalibrationPicture::left_out says so.
  [[nodiscard]] Result<void> add(const std::string& name, ImageView luma);
  // A picture that can't be read.
  void add_unreadable(const std::string& name, const std::string& why);
  // Pictures that are held in memory; never more than most_candidates.
  [[nodiscard]] int held() const;

  // Solves, once. An error is one line that says what the pictures lack. Fails soon after `stop`
  // was requested. `tell` is called by this thread whenever something else begins.
  [[nodiscard]] Result<CameraCalibration> finish(std::stop_token stop = {},
                                                 const TellStep& tell = {});

 private:
  struct Impl;
  explicit CameraCalibrator(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
