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
  std::optional<Eigen::Vector2d>
      non_monotonic_px;  // non_monotonic_place_in_image(): such a lens is never chosen
  bool chosen = false;
  bool rival = false;       // explains held-out views no worse than the chosen one
  CameraModel camera = {};  // as solved
};
[[nodiscard]] std::string lens_name(const ModelTrial& trial);  // "plumb_bob", "plumb_bob, k3 = 0"

// The place on the image's border [px], nearest to the principal point, where the distortion is
// non-monotonic; nothing if there is none. A fisheye lens that still grows at 90 degrees from its
// axis has none: this camera model does not reach further.
[[nodiscard]] std::optional<Eigen::Vector2d> non_monotonic_place_in_image(
    const CameraModel& camera);

// Largest ratio of held-out errors for which additional parameters are worthwhile.
inline constexpr double kWorthwhile = 0.97;

// Progress for users: `step` of at most `most`, from 1.
struct SolvingStep {
  std::string what;  // "plumb_bob, free board"
  int step = 0;
  int most = 0;
};
using StepCallback = std::function<void(const SolvingStep&)>;

struct LensChoice {
  std::optional<DistortionModel> model;  // only this one
  bool for_kalibr = false;               // only lenses that Kalibr's files have
  std::stop_token stop = {};             // ends the search, with an error
  StepCallback tell = {};                // called at each step of choose_lens()
};
// Largest number of steps of choose_lens(), with a given or a chosen board shape.
[[nodiscard]] int most_steps(const LensChoice& choice, bool shape_given);
// A lens for refining corners and as the start of choose_lens(). `width`, `height`: of the images
// [px].
[[nodiscard]] Result<CalibrationSolution> first_solution(int width, int height,
                                                         const std::vector<Eigen::Vector3d>& board,
                                                         const std::vector<CalibrationView>& views,
                                                         const LensChoice& choice);

// Returns the solution that explains held-out views best; a lens with more parameters must be
// clearly better. Appends a trial for each lens and board. Fails if every lens is non-monotonic in
// the image.
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
