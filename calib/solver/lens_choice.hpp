// Which lens explains the views, of those that a camera file can say.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/solver/intrinsics_solver.hpp"

namespace penumbra {

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
  bool rival = false;       // explains views held out of it no worse than the chosen one does
  CameraModel camera = {};  // as solved
};
[[nodiscard]] std::string lens_name(const ModelTrial& trial);  // "plumb_bob", "plumb_bob, k3 = 0"

// Where in the image [px] a lens says nothing true, since its distortion folds back or levels off
// before: the place on the image's border that is nearest to the principal point. Nothing where it
// describes all of the image. A fisheye lens that still grows at 90 degrees from its axis is whole:
// what it sees beyond is beyond this camera model's directions.
[[nodiscard]] std::optional<Eigen::Vector2d> fold_in_image(const CameraModel& camera);

// Of the held-out error: what a further freedom must bring.
inline constexpr double kWorthwhile = 0.97;

// Where a search is, for people: `step` of at most `most`, from 1.
struct SolvingStep {
  std::string what;  // "plumb_bob, free board"
  int step = 0;
  int most = 0;
};
using TellStep = std::function<void(const SolvingStep&)>;

// Which lenses are tried, the simplest first.
struct LensChoice {
  std::optional<DistortionModel> model;  // only this one
  bool for_kalibr = false;               // only what Kalibr's files can say
  std::stop_token stop = {};             // ends the search, with an error
  TellStep tell = {};                    // what choose_lens() tries next
};
// Steps that choose_lens() tells at most, where the board's shape is given, and where it is chosen.
[[nodiscard]] int most_steps(const LensChoice& choice, bool shape_given);
// A lens near enough for corners to be refined with it, and for choose_lens() to begin from.
// `width` and `height` are the pictures' [px].
[[nodiscard]] Result<CalibrationSolution> first_solution(int width, int height,
                                                         const std::vector<Eigen::Vector3d>& board,
                                                         const std::vector<CalibrationView>& views,
                                                         const LensChoice& choice);

// The solution with the lens that explains views held out of it best; a lens with more freedoms has
// to be clearly better, and one that folds in the image is not taken. All lenses are compared on
// the same corners: those that are outliers to the lens that explains most. From a solution near
// by; `trials` gets a line for each. An error says where every lens folds, or why none is found.
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

}  // namespace penumbra
