// Pictures of a target -> a camera that can be trusted, or what is missing: which views count,
// which lens explains them, what the result is worth, and a verdict in words.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/intrinsics_solver.hpp"
#include "calib/table_volume.hpp"
#include "calib/target.hpp"
#include "calib/target_detector.hpp"
#include "tracking/tone_estimator.hpp"

namespace penumbra {

struct CalibrationOptions {
  std::optional<DistortionModel> model;  // else chosen by cross-validation
  std::optional<BoardShape> shape;       // else chosen by cross-validation
  // Only lenses that Kalibr's files can say: plumb_bob without k3, and fisheye.
  bool for_kalibr = false;
  int most_views = 60;  // of more, those are taken that differ most
};

// One picture, used or not.
struct CalibrationPicture {
  std::string name;
  TargetView view;
  std::string left_out;            // why; empty when used
  int solved = -1;                 // index into CalibrationSolution::views; -1 when left out
  int width = 0;                   // [px]
  int height = 0;                  // [px]
  std::vector<std::uint8_t> luma;  // rows of `width` bytes; empty where nothing was found
  [[nodiscard]] ImageView picture() const {
    return {luma.data(), luma.empty() ? 0 : width, height, width};
  }
};

// A lens and board that were tried.
struct ModelTrial {
  DistortionModel model = DistortionModel::plumb_bob;
  bool without_k3 = false;
  BoardShape shape = BoardShape::rigid;
  double rms_px = 0.0;
  std::optional<double> held_out_px;
  // Where in the image the lens folds (fold_in_image()): then it is never chosen.
  std::optional<Eigen::Vector2d> fold_px;
  bool chosen = false;
};
[[nodiscard]] std::string lens_name(const ModelTrial& trial);  // "plumb_bob", "plumb_bob, k3 = 0"

// Where in the image [px] a lens says nothing true, since its distortion folds back or levels off
// before: the place on the image's border that is nearest to the principal point. Nothing where it
// describes all of the image. A fisheye lens that still grows at 90 degrees from its axis is whole:
// what it sees beyond is beyond this camera model's directions.
[[nodiscard]] std::optional<Eigen::Vector2d> fold_in_image(const CameraModel& camera);

// Which lenses are tried, the simplest first.
struct LensChoice {
  std::optional<DistortionModel> model;  // only this one
  bool for_kalibr = false;               // only what Kalibr's files can say
  std::stop_token stop = {};             // ends the search, with an error
};
// The solution with the lens that explains views held out of it best; a lens with more freedoms has
// to be clearly better, and one that folds in the image is not taken. From a solution near by;
// `trials` gets a line for each. An error says where every lens folds, or why none is found.
struct ChosenLens {
  CalibrationSolution solution;
  std::optional<double> held_out_px;
  bool without_k3 = false;
  std::size_t trial = 0;
};
[[nodiscard]] Result<ChosenLens> choose_lens(const CalibrationSolution& start,
                                             const std::vector<Eigen::Vector3d>& board,
                                             const std::vector<CalibrationView>& views,
                                             const LensChoice& choice,
                                             std::optional<BoardShape> shape,
                                             std::vector<ModelTrial>& trials);

// Standard deviation of the projection over the image [px], along its worst direction.
struct UncertaintyMap {
  int columns = 0;
  int rows = 0;
  std::vector<double> sigma_px;  // row by row, at the middles of equal cells; NaN where unreachable
  // Both infinite for a lens that folds in the image.
  double mean_px = 0.0;
  double largest_px = 0.0;
};
[[nodiscard]] UncertaintyMap uncertainty_map(const CameraModel& camera,
                                             const Eigen::MatrixXd& covariance, int columns = 32,
                                             int rows = 24);

// How far two cameras' projections are from each other, over the first one's image: no rotation is
// fitted.
struct ProjectionDifference {
  double mean_px = 0.0;
  double largest_px = 0.0;
};
[[nodiscard]] ProjectionDifference projection_difference(const CameraModel& a,
                                                         const CameraModel& b);

enum class CalibrationGrade { good, usable, poor };
[[nodiscard]] std::string_view to_string(CalibrationGrade grade);

struct CameraCalibration {
  CalibrationSolution solution;
  std::vector<CalibrationPicture> pictures;
  std::vector<ModelTrial> trials;
  std::optional<double> held_out_px;
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

class CameraCalibrator {
 public:
  [[nodiscard]] static Result<CameraCalibrator> create(const Target& target,
                                                       const CalibrationOptions& options = {});
  CameraCalibrator(CameraCalibrator&&) noexcept;
  CameraCalibrator& operator=(CameraCalibrator&&) noexcept;
  ~CameraCalibrator();

  // Looks for the target in a picture. Fails when the picture's size is not that of the others.
  [[nodiscard]] Result<void> add(const std::string& name, ImageView luma);
  // A picture that can't be read.
  void add_unreadable(const std::string& name, const std::string& why);

  // Solves, once. An error is one line that says what the pictures lack. Fails soon after `stop`
  // was requested.
  [[nodiscard]] Result<CameraCalibration> finish(std::stop_token stop = {});

 private:
  struct Impl;
  explicit CameraCalibrator(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
