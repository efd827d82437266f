// Chooses the lens model by cross-validation (docs/calibration.md#lens-choice).
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/solver/intrinsics_solver.hpp"

namespace penumbra {

struct ModelTrial {
  DistortionModel model = DistortionModel::plumb_bob;
  bool without_k3 = false;
  BoardShape shape = BoardShape::rigid;
  double rms_px = 0.0;
  std::optional<double> held_out_px;
  // non_monotonic_place_in_image(). If set, the lens is never chosen.
  std::optional<Eigen::Vector2d> non_monotonic_px;
  bool chosen = false;
  bool rival = false;       // its held-out error is hardly larger than that of the chosen lens
  CameraModel camera = {};  // the solved camera
};
[[nodiscard]] std::string lens_name(const ModelTrial& trial);  // "plumb_bob", "plumb_bob, k3 = 0"

// Returns the pixel on the image's border, nearest to the principal point, at which the distortion
// is non-monotonic; nullopt if there is none. A fisheye lens that is monotonic up to 90 degrees
// from its axis has none, because this camera model ends there.
[[nodiscard]] std::optional<Eigen::Vector2d> non_monotonic_place_in_image(
    const CameraModel& camera);

// Additional parameters are worthwhile if the held-out error falls to this fraction or less.
inline constexpr double kMaxHeldOutRatio = 0.97;

// Progress for users. choose_lens() may end before the last step.
struct SolvingStep {
  std::string what;  // "plumb_bob, free board"
  int step = 0;
  int max_step = 0;  // number of the last step
};
using StepCallback = std::function<void(const SolvingStep&)>;

struct LensChoice {
  std::optional<DistortionModel> model;  // if set, the only model tried
  bool for_kalibr = false;               // only lenses that Kalibr's files can represent
  std::stop_token stop = {};             // ends the search, with an error
  StepCallback on_step = {};             // called at each step of choose_lens()
};
// Returns the maximum number of steps of choose_lens(), with a given or a chosen board shape.
[[nodiscard]] int max_steps(const LensChoice& choice, bool shape_given);
// Returns a first lens, for refining corners and as the start of choose_lens(). `width`, `height`:
// image size [px].
[[nodiscard]] Result<CalibrationSolution> first_solution(int width, int height,
                                                         const std::vector<Eigen::Vector3d>& board,
                                                         const std::vector<CalibrationView>& views,
                                                         const LensChoice& choice);

struct ChosenLens {
  CalibrationSolution solution;
  std::optional<double> held_out_px;
  bool without_k3 = false;
  std::size_t trial = 0;  // index into `trials`
};
// Returns the solution with the smallest held-out error; a lens with more parameters must be
// clearly better. Appends a trial for each lens and board shape. Fails if every lens is
// non-monotonic in the image.
[[nodiscard]] Result<ChosenLens> choose_lens(const CalibrationSolution& start,
                                             const std::vector<Eigen::Vector3d>& board,
                                             const std::vector<CalibrationView>& views,
                                             const LensChoice& choice,
                                             std::optional<BoardShape> shape,
                                             std::vector<ModelTrial>& trials);

}  // namespace penumbra
