#include "calib/solver/lens_choice.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "calib/target/image_cells.hpp"

namespace penumbra {
namespace {

struct Lens {
  DistortionModel model = DistortionModel::plumb_bob;
  bool without_k3 = false;
  bool operator==(const Lens&) const = default;
};

// Returns the lenses to try, in order of increasing complexity.
std::vector<Lens> lenses_of(const LensChoice& choice) {
  constexpr Lens kNoK3 = {DistortionModel::plumb_bob, true};
  constexpr Lens kPlumbBob = {DistortionModel::plumb_bob, false};
  if (choice.model)
    return {{*choice.model, choice.for_kalibr && *choice.model == DistortionModel::plumb_bob}};
  if (choice.for_kalibr) return {kNoK3, {DistortionModel::fisheye}};
  return {kNoK3, kPlumbBob, {DistortionModel::fisheye}, {DistortionModel::rational}};
}

// Ratios of held-out errors: docs/calibration.md#lens-choice.
constexpr double kMuchBetter = 0.85;
constexpr double kOtherModelRatio = 0.9;
constexpr double kMoreOutliers = 0.05;      // fraction of all corners
constexpr double kSignificantSigmas = 2.0;  // minimum significant difference [standard errors]

// Tries lenses and board shapes on the same corners and keeps the best.
class LensSearch {
 public:
  LensSearch(const CalibrationSolution& start, const std::vector<Eigen::Vector3d>& board,
             const std::vector<CalibrationView>& views, const LensChoice& choice,
             std::vector<ModelTrial>& trials, int max_steps)
      : start_(start),
        board_(board),
        views_(views),
        choice_(choice),
        trials_(trials),
        max_steps_(max_steps) {}

  // Solves with every lens. Later solutions use the outliers of the lens that explains the most
  // corners, because a lens with too few parameters rejects corners far from the centre.
  void decide_outliers(const std::vector<Lens>& lenses, BoardShape shape);
  void consider(const Lens& lens, BoardShape shape);
  // Solves the best lens again and finds its outliers. Replaces the old solution unless the new one
  // has many more outliers. `for_all`: later lenses use these outliers as well.
  void refine_best(const std::vector<CalibrationView>& views, bool for_all);
  // Marks the lenses whose held-out errors are hardly larger than those of the best lens.
  void mark_rivals();
  void on_step(const Lens& lens, BoardShape shape) {
    ++steps_;
    if (!choice_.on_step) return;
    ModelTrial trial;
    trial.model = lens.model;
    trial.without_k3 = lens.without_k3;
    choice_.on_step({fmt::format("{}, {} board", lens_name(trial), to_string(shape)), steps_,
                     std::max(steps_, max_steps_)});
  }

  std::optional<ChosenLens> best;
  std::optional<Error> first_error;

 private:
  [[nodiscard]] SolverOptions solver_of(const Lens& lens, BoardShape shape) const {
    SolverOptions solver;
    solver.stop = choice_.stop;
    solver.without_k3 = lens.without_k3;
    solver.model = lens.model;
    solver.shape = shape;
    return solver;
  }

  void copy_outliers(const CalibrationSolution& solution) {
    for (std::size_t v = 0; v < views_.size(); ++v) views_[v].outlier = solution.views[v].outlier;
  }

  const CalibrationSolution& start_;
  const std::vector<Eigen::Vector3d>& board_;
  std::vector<CalibrationView> views_;
  const LensChoice& choice_;
  std::vector<ModelTrial>& trials_;
  int steps_ = 0;
  int max_steps_ = 0;
  struct Solved {
    Lens lens;
    BoardShape shape;
    CalibrationSolution solution;
  };
  std::vector<Solved> initial_;  // solutions of decide_outliers()
  std::optional<std::vector<ViewError>> best_held_out_;
  std::vector<std::optional<std::vector<ViewError>>> held_out_;  // one per trial
};

// Returns the number of corners that are inliers at this noise [px].
int explained_corners(const CalibrationSolution& solution, double noise_px) {
  const double limit = kOutlierSigmas * noise_px;
  int count = 0;
  for (const SolvedView& view : solution.views) {
    count += static_cast<int>(std::ranges::count_if(
        view.residuals_px, [&](const Eigen::Vector2d& r) { return r.norm() <= limit; }));
  }
  return count;
}

// Returns the mean of b - a (squared errors of views), divided by its standard error; 0 if equal.
double standard_errors(const std::vector<ViewError>& a, const std::vector<ViewError>& b) {
  const auto n = static_cast<double>(a.size());
  double mean = 0.0;
  for (std::size_t v = 0; v < a.size(); ++v) mean += (b[v].squared_px2 - a[v].squared_px2) / n;
  double variance = 0.0;  // variance of the mean
  for (std::size_t v = 0; v < a.size(); ++v) {
    const double off = b[v].squared_px2 - a[v].squared_px2 - mean;
    variance += off * off / (n * (n - 1.0));
  }
  return variance > 0.0 ? mean / std::sqrt(variance) : 0.0;
}

// Returns true if `a` is much better, or significantly better with a ratio below `max_ratio`.
bool clearly_better(const std::vector<ViewError>& a, const std::vector<ViewError>& b,
                    double max_ratio) {
  const double ratio = rms_of(a) / rms_of(b);
  return ratio < kMuchBetter || (ratio < max_ratio && standard_errors(a, b) > kSignificantSigmas);
}

void LensSearch::decide_outliers(const std::vector<Lens>& lenses, BoardShape shape) {
  const Solved* cleanest = nullptr;  // the solution with the least noise
  initial_.reserve(lenses.size());
  for (const Lens& lens : lenses) {
    if (choice_.stop.stop_requested()) return;
    on_step(lens, shape);
    Result<CalibrationSolution> solved = solve_intrinsics(
        cleanest == nullptr ? start_ : cleanest->solution, board_, views_, solver_of(lens, shape));
    if (!solved) {
      if (!first_error) first_error = solved.error();
      continue;
    }
    initial_.push_back({lens, shape, std::move(*solved)});
    if (cleanest == nullptr || initial_.back().solution.noise_px < cleanest->solution.noise_px)
      cleanest = &initial_.back();
  }
  if (cleanest == nullptr) return;
  const double noise = cleanest->solution.noise_px;
  const Solved* fittest = &initial_.front();  // explains the most corners
  for (const Solved& solved : initial_) {
    if (explained_corners(solved.solution, noise) > explained_corners(fittest->solution, noise))
      fittest = &solved;
  }
  copy_outliers(fittest->solution);
}

void LensSearch::consider(const Lens& lens, BoardShape shape) {
  if (choice_.stop.stop_requested()) return;
  on_step(lens, shape);
  const SolverOptions solver = solver_of(lens, shape);
  const auto initial = std::ranges::find_if(
      initial_, [&](const Solved& solved) { return solved.lens == lens && solved.shape == shape; });
  Result<CalibrationSolution> solved =
      solve_intrinsics(initial != initial_.end() ? initial->solution
                       : best                    ? best->solution
                                                 : start_,
                       board_, views_, solver);
  if (!solved) {
    if (!first_error) first_error = solved.error();
    return;
  }
  const auto held_out = held_out_errors(*solved, board_, views_, solver);
  const std::optional<double> held_out_px =
      held_out ? std::optional(rms_of(*held_out)) : std::nullopt;
  const auto non_monotonic = non_monotonic_place_in_image(solved->camera);
  trials_.push_back({lens.model, lens.without_k3, shape, solved->rms_px, held_out_px, non_monotonic,
                     false, false, solved->camera});
  held_out_.push_back(held_out);
  const bool other_model = best && best->solution.camera.parameters().model != lens.model;
  const double max_ratio = other_model ? kOtherModelRatio : kMaxHeldOutRatio;
  // A lens without held-out errors loses against one with them.
  if (non_monotonic ||
      (best &&
       !(held_out && (!best_held_out_ || clearly_better(*held_out, *best_held_out_, max_ratio)))))
    return;
  best = ChosenLens{std::move(*solved), held_out_px, lens.without_k3, trials_.size() - 1};
  best_held_out_ = held_out;
}

void LensSearch::mark_rivals() {
  if (!best_held_out_) return;
  for (std::size_t t = 0; t < trials_.size(); ++t) {
    if (t == best->trial || !held_out_[t]) continue;
    const double ratio = rms_of(*held_out_[t]) / rms_of(*best_held_out_);
    trials_[t].rival = kMaxHeldOutRatio * ratio <= 1.0 &&
                       standard_errors(*best_held_out_, *held_out_[t]) <= kSignificantSigmas;
  }
}

void LensSearch::refine_best(const std::vector<CalibrationView>& views, bool for_all) {
  const CalibrationSolution& before = best->solution;
  const SolverOptions solver =
      solver_of({before.camera.parameters().model, best->without_k3}, before.shape);
  Result<CalibrationSolution> again = solve_intrinsics(before, board_, views, solver);
  if (!again || again->outliers - before.outliers > kMoreOutliers * before.corners ||
      non_monotonic_place_in_image(again->camera))
    return;
  best->solution = std::move(*again);
  if (!for_all) return;
  copy_outliers(best->solution);
  best_held_out_ = held_out_errors(best->solution, board_, views_, solver);
  best->held_out_px.reset();
  if (best_held_out_) best->held_out_px = rms_of(*best_held_out_);
  trials_[best->trial].held_out_px = best->held_out_px;
  trials_[best->trial].rms_px = best->solution.rms_px;
}

}  // namespace

// Two steps per lens; without a given shape, also two shapes and the more complex lenses.
int max_steps(const LensChoice& choice, bool shape_given) {
  const auto lenses = static_cast<int>(lenses_of(choice).size());
  return shape_given ? 2 * lenses : 3 * lenses + 1;
}

std::string lens_name(const ModelTrial& trial) {
  return fmt::format("{}{}", short_name(trial.model), trial.without_k3 ? ", k3 = 0" : "");
}

std::optional<Eigen::Vector2d> non_monotonic_place_in_image(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const bool wide =
      !is_polynomial(p.model) && !std::isfinite(camera.max_radius());  // maps any angle
  constexpr int kSteps = 64;                                           // along each side
  const Eigen::Vector2d centre(p.cx, p.cy);
  std::optional<Eigen::Vector2d> nearest;
  const auto check = [&](double x, double y) {
    const Eigen::Vector2d pixel(x, y);
    const auto direction = camera.unproject(pixel);
    const bool monotonic =
        direction ? camera.distortion_jacobian(direction->head<2>()).determinant() > 0.0 : wide;
    if (!monotonic && (!nearest || (pixel - centre).norm() < (*nearest - centre).norm()))
      nearest = pixel;
  };
  for (int i = 0; i <= kSteps; ++i) {
    const double x = (p.width - 1.0) * i / kSteps;
    const double y = (p.height - 1.0) * i / kSteps;
    check(x, 0.0);
    check(x, p.height - 1.0);
    check(0.0, y);
    check(p.width - 1.0, y);
  }
  return nearest;
}

Result<CalibrationSolution> first_solution(int width, int height,
                                           const std::vector<Eigen::Vector3d>& board,
                                           const std::vector<CalibrationView>& views,
                                           const LensChoice& choice) {
  SolverOptions solver;
  solver.without_k3 = choice.for_kalibr;
  solver.stop = choice.stop;
  if (choice.model) {
    solver.model = *choice.model;
    return solve_intrinsics(width, height, board, views, solver);
  }
  Result<CalibrationSolution> best = solve_intrinsics(width, height, board, views, solver);
  if (best && !solver.without_k3 && non_monotonic_place_in_image(best->camera)) {
    solver.without_k3 = true;
    Result<CalibrationSolution> plainer = solve_intrinsics(width, height, board, views, solver);
    if (plainer) best = std::move(plainer);
  }
  solver.model = DistortionModel::fisheye;
  // A polynomial in tan(angle) fits a wide lens badly or not at all.
  if (!best || !best->explains_corners()) {
    Result<CalibrationSolution> wide = solve_intrinsics(width, height, board, views, solver);
    if (wide && (!best || wide->noise_px < best->noise_px)) return wide;
  }
  return best;
}

Result<ChosenLens> choose_lens(const CalibrationSolution& start,
                               const std::vector<Eigen::Vector3d>& board,
                               const std::vector<CalibrationView>& views, const LensChoice& choice,
                               std::optional<BoardShape> shape, std::vector<ModelTrial>& trials) {
  const std::vector<Lens> lenses = lenses_of(choice);
  LensSearch tried(start, board, views, choice, trials, max_steps(choice, shape.has_value()));
  const BoardShape first_shape = shape.value_or(BoardShape::rigid);
  tried.decide_outliers(lenses, first_shape);
  for (const Lens& lens : lenses) tried.consider(lens, first_shape);
  std::optional<ChosenLens>& best = tried.best;
  // If no corner is near the image's border, a requested plumb_bob may need k3 = 0 to be monotonic.
  if (!best && choice.model == DistortionModel::plumb_bob && !choice.for_kalibr)
    tried.consider({DistortionModel::plumb_bob, true}, first_shape);
  if (best && !shape) {
    const auto lens_of_best = [&] {
      return Lens{best->solution.camera.parameters().model, best->without_k3};
    };
    tried.consider(lens_of_best(), BoardShape::bowed);
    // Point offsets need many views.
    if (views.size() >= 8) tried.consider(lens_of_best(), BoardShape::free);
    // Board warp may have hidden the need for more lens parameters.
    const BoardShape found = best->solution.shape;
    if (found != BoardShape::rigid && !choice.stop.stop_requested()) tried.refine_best(views, true);
    const Lens before = lens_of_best();
    bool richer = false;
    for (const Lens& lens : lenses) {
      if (found != BoardShape::rigid && richer) tried.consider(lens, found);
      richer = richer || lens == before;
    }
  }
  if (choice.stop.stop_requested()) return fail("ended early");
  if (best) {
    tried.mark_rivals();
    tried.refine_best(views, false);
    trials[best->trial].rms_px = best->solution.rms_px;
    trials[best->trial].camera = best->solution.camera;
    if (choice.stop.stop_requested()) return fail("ended early");
    trials[best->trial].chosen = true;
    return std::move(*best);
  }
  if (!trials.empty() && trials.front().non_monotonic_px) {
    const Eigen::Vector2d& at = *trials.front().non_monotonic_px;
    const ImageCells cells{3, 3, start.camera.width(), start.camera.height()};
    return fail(
        "every lens that explains the views has non-monotonic distortion in the image, first at "
        "({:.0f}, {:.0f}): no corners were seen so far out; take views with the target near the {} "
        "and in the other corners{}",
        at.x(), at.y(), cells.name(cells.at(at)),
        choice.model == DistortionModel::fisheye ? "" : ", or try --model fisheye");
  }
  return fail(
      "the views do not determine a lens ({}); take views with the target near every corner of the "
      "image, tilted in several directions",
      tried.first_error ? tried.first_error->message : "none explains them");
}

}  // namespace penumbra
