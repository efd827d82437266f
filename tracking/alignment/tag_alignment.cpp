#include "tracking/alignment/tag_alignment.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "core/propagate.hpp"
#include "tracking/alignment/aligned_tag.hpp"
#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/edge_samples.hpp"
#include "tracking/alignment/map_agreement.hpp"
#include "tracking/alignment/motion_blur_check.hpp"
#include "tracking/alignment/pattern_search.hpp"
#include "tracking/alignment/pose_solver.hpp"
#include "tracking/alignment/simd/alignment_loops.hpp"
#include "tracking/math/se3.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

// Convergence, see docs/tracking.md#convergence.
constexpr double kCornerMoved_px = 0.25;  // a fine round with a larger motion is repeated
constexpr double kConverged_px = 0.03;
constexpr double kNearlyConverged_px = 0.06;
constexpr double kConvergesFrom_px = 0.1;  // the next step is about kConverged_px
// Lengths of steps in standard deviations of the pose (Mahalanobis norm).
constexpr double kConverged_sigmas = 1.0;
constexpr double kNearlyConverged_sigmas = 3.0;
constexpr double kSlopeConverged_sigmas = 8.0;  // for StepBy::slope
constexpr int kFineRounds = 3;
constexpr int kFineSteps = 5;           // maximum per round
constexpr int kFastSamples = 1920;      // total, if each tag has 128 or more
constexpr int kFastSamplesOfTag = 400;  // maximum per tag for three or more tags
constexpr int kSparseSamples = 640;     // total
constexpr double kWideCutoff = 0.8;     // cutoff of Tukey's weights, as a fraction of the gain
constexpr double kFineCutoff = 0.6;     // as kWideCutoff, for the fine stage

// Initial memory for samples: the smaller of the estimates by image size and by number of tags.
constexpr std::size_t kPixelsPerSample = 12;
constexpr std::size_t kSamplesPerTag = 4096;
constexpr std::size_t kFloatsPerSample = 17;  // memory of a sample with one line per axis [floats]

// Returns a cap that fills `blocks` blocks of the SIMD loops, with a margin for longer walks.
constexpr int filled_blocks(int blocks) {
  return (simd::kBlock - 4) * blocks;
}

// Numbers of samples per tag in the fine stage.
struct FinePlan {
  bool every_pixel = false;
  int cap = 0;
  int first = 0;               // initial number; lower than the cap if sampling may stop early
  int sparse_cap = 0;          // maximum number in a round far from the pose
  bool sparse_rounds = true;   // rounds that will be repeated may use fewer samples and stop early
  bool begins_sparse = false;  // the first round uses sparse_cap
  double near_px = 0.0;        // a round may end after a step shorter than this
};

}  // namespace

double variance_inflation(const AlignmentResult& result) {
  // Inflation by Tukey's weights, 1.053 / (0.758 / 0.915^2); see docs/tracking.md#design-effect.
  constexpr double kTukeyFactor = 1.16;
  return kTukeyFactor * std::max(result.design_effect, 1.0);
}

struct TagAligner::Impl {
  Impl(AlignmentProblem problem_, std::size_t initial_floats)
      : problem(std::move(problem_)), sampler(problem, initial_floats) {}
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  AlignmentProblem problem;
  PatternSearch search{problem};
  EdgeSampler sampler;
  PoseSolver solver{problem};
  MapAgreement agreement;
  SampleNeed sample_need;
  AlignmentInput input;  // current frame's image and prediction
  AlignmentResult result;

  enum class Start { near_pose, search, independent_search };

  void begin(const AlignmentInput& frame);
  [[nodiscard]] bool project_at_prediction();
  [[nodiscard]] AlignmentResult run(const AlignmentInput& frame, bool with_search);
  [[nodiscard]] bool attempt(Start start, bool may_be_near);
  [[nodiscard]] bool wide_stage();
  [[nodiscard]] FinePlan plan_fine_stage(bool near) const;
  [[nodiscard]] bool fine_stage(bool near);
  [[nodiscard]] std::optional<bool> fine_round(const FinePlan& plan, int round, bool near,
                                               bool sparse);
  [[nodiscard]] int more_samples(const FinePlan& plan, int now);
  void report_pose();
  void report_motion();
  [[nodiscard]] bool fail_for(std::string_view reason) {
    result.reason = reason;
    return false;
  }
};

void TagAligner::Impl::begin(const AlignmentInput& frame) {
  problem.begin(frame);
  input = frame;
  result = {};
}

// Projects the tags at the prediction, for a search; returns false if none is in view.
bool TagAligner::Impl::project_at_prediction() {
  problem.T_camera_map = problem.T_predicted;
  problem.find_visible(Projection::search);
  return !problem.active.empty();
}

AlignmentResult TagAligner::Impl::run(const AlignmentInput& frame, bool with_search) {
  begin(frame);
  const Start start = with_search ? Start::search : Start::near_pose;
  bool good = attempt(start, true);
  // Repeats an attempt that skipped the wide stage.
  if (!good && !problem.counters.wide_stage) good = attempt(start, false);
  if (!good && with_search && !problem.active.empty()) {
    std::ignore = attempt(Start::independent_search, false);
  }
  if (result.verified && input.map_sigma_m > 0.0 && !problem.motion_prior) {
    const Vector6d motion =
        agreement.motion_for_displaced_tags(problem, solver.variance(), input.map_sigma_m);
    problem.T_camera_map = exp_se3(motion) * problem.T_camera_map;
  }
  report_pose();
  return result;
}

// Runs the search, the wide and the fine stage, and verifies the pose.
bool TagAligner::Impl::attempt(Start start, bool may_be_near) {
  AlignmentCounters& counters = problem.counters;
  // Discards the results of the previous attempt.
  result.displacement_px = 0.0;
  result.disagreement = 1.0;
  result.map_covariance.setZero();
  result.map_inconsistent = false;
  result.inconsistent_tag = -1;
  counters.far_start = false;
  counters.sampling_stopped = false;
  problem.reset_motion();
  bool near = false;
  if (start != Start::near_pose) {
    const bool any = project_at_prediction();
    counters.tags_visible = static_cast<int>(problem.active.size());
    if (!any) return fail_for("no tag in view");
    // If the search fails, the pose remains the prediction.
    std::ignore = start == Start::search ? search.search(input.previous_contrast)
                                         : search.search_independently();
    near = may_be_near && search.found_near();
  }
  problem.find_visible(near ? Projection::fine : Projection::wide);
  if (start == Start::near_pose) counters.tags_visible = static_cast<int>(problem.active.size());
  if (problem.active.empty()) return fail_for("no tag in view");
  sampler.read_levels();
  solver.begin();
  counters.wide_stage = !near;
  if ((!near && !wide_stage()) || !fine_stage(near)) return fail_for("too few pixels on tags");
  agreement.check(problem, solver, result);
  decode_tags(problem, sampler, result);
  return result.verified;
}

bool TagAligner::Impl::wide_stage() {
  const int cap = filled_blocks(problem.active.size() > 8 ? 1 : 2);
  sampler.free_samples();
  for (AlignedTag* tag : problem.active) sampler.select(*tag, true, cap);
  return solver.step(0.0, PoseSolver::StepBy::weights) &&
         solver.step(kWideCutoff, PoseSolver::StepBy::weights);
}

FinePlan TagAligner::Impl::plan_fine_stage(bool near) const {
  const AlignmentOptions& options = problem.options;
  const auto tags = static_cast<int>(problem.active.size());
  // A velocity doubles the number of unknowns.
  const int fast_samples = problem.motion_prior ? 2 * kFastSamples : kFastSamples;
  FinePlan plan;
  plan.every_pixel = options.effort == AlignmentEffort::accurate;
  plan.cap = plan.every_pixel ? kEveryPixel
                              : filled_blocks(std::clamp(fast_samples / (simd::kBlock * tags), 2,
                                                         kFastSamplesOfTag / simd::kBlock));
  plan.first = sample_need
                   ? std::min(plan.cap, std::max(input.first_samples / tags, filled_blocks(1)))
                   : plan.cap;
  const int block_of_each = simd::kBlock * tags;
  plan.sparse_cap = filled_blocks(
      std::clamp(kSparseSamples / block_of_each, block_of_each >= kSparseSamples ? 1 : 2, 4));
  // Far from the pose, few samples suffice.
  plan.sparse_rounds = !sample_need;
  plan.begins_sparse = plan.sparse_rounds && (input.starts_far || (near && plan.every_pixel));
  plan.near_px = !plan.every_pixel && tags > 2 ? kConvergesFrom_px : kNearlyConverged_px;
  return plan;
}

// Samples at the current pose and solves; repeats until the tags stay near their samples.
bool TagAligner::Impl::fine_stage(bool near) {
  const FinePlan plan = plan_fine_stage(near);
  AlignmentCounters& counters = problem.counters;
  solver.forget_noise();
  int now = plan.first;
  int samples_before = 0;
  bool sparse = plan.begins_sparse;
  for (int round = 0; round < kFineRounds;) {
    if (round > 0 || !near) problem.find_visible(Projection::fine);
    counters.samples = 0;
    sampler.free_samples();
    for (AlignedTag* tag : problem.active) {
      sampler.select(*tag, false, sparse ? std::min(now, plan.sparse_cap) : now);
      counters.samples += tag->used;
    }
    const std::optional<bool> far = fine_round(plan, round, near, sparse);
    if (!far) return false;
    if (round == 0) counters.far_start = *far;
    ++round;
    if (std::exchange(sparse, false) || (*far && round < kFineRounds)) continue;
    result.design_effect = design_effect(problem, solver, sampler.arena(), kFineCutoff);
    if (!sample_need || now >= plan.cap || counters.samples <= samples_before) break;
    samples_before = counters.samples;
    const int more = more_samples(plan, now);
    if (more == now) break;
    now = more;
    round = kFineRounds - 1;  // already near the pose
  }
  counters.sampling_stopped =
      sample_need != nullptr && now < plan.cap &&
      std::ranges::any_of(problem.active, [](const AlignedTag* tag) { return tag->thinned; });
  return true;
}

// Steps until the pose converges. Returns true if the tags need new samples, nullopt for too few.
std::optional<bool> TagAligner::Impl::fine_round(const FinePlan& plan, int round, bool near,
                                                 bool sparse) {
  const double settled = plan.every_pixel ? 0.85 : 0.7;
  const bool within_noise = plan.every_pixel;
  const bool by_slope = within_noise && !sample_need && round > 0 && !sparse;
  const auto by = by_slope ? PoseSolver::StepBy::slope : PoseSolver::StepBy::weights;
  double round_moved = 0.0;
  bool far = false;
  for (int i = 0; i < kFineSteps; ++i) {
    // The first step from a nearby start uses no cutoff.
    const auto step = solver.step(near && round == 0 && i == 0 ? 0.0 : kFineCutoff, by);
    if (!step) return std::nullopt;
    if (problem.motion_prior) {
      for (AlignedTag* tag : problem.active) sampler.follow_shear(*tag);
    }
    const double before = solver.noise_share();
    solver.measure_noise();
    round_moved += step->moved_px;
    far = round_moved >= kCornerMoved_px;
    // At rest, the noise no longer falls (outliers lose no more weight), or the step is below it.
    const bool at_rest =
        solver.noise_share() > settled * before || step->sigmas < kConverged_sigmas;
    const double nearly_sigmas = by_slope ? kSlopeConverged_sigmas : kNearlyConverged_sigmas;
    // A later round starts near the pose, so one step may be sufficient.
    if (plan.sparse_rounds && round > 0 && step->moved_px < plan.near_px &&
        solver.noise_share() > 0.9 * before && (!within_noise || step->sigmas < nearly_sigmas))
      break;
    if (i == 0) continue;
    // A round that will be repeated need not converge.
    const bool repeated = plan.sparse_rounds && (sparse || (far && round + 1 < kFineRounds));
    if (repeated && step->moved_px < kCornerMoved_px && at_rest) break;
    if (step->moved_px < kConverged_px && at_rest) break;
  }
  return far;
}

// Returns the number of samples per tag for the next round, or `now` if no more are needed.
int TagAligner::Impl::more_samples(const FinePlan& plan, int now) {
  report_pose();
  const double times = sample_need(result);
  if (times <= 1.0) return now;
  // Requests 10 % more, so that one round is sufficient.
  const double wanted = 1.1 * times * static_cast<double>(now);
  const int more = wanted < static_cast<double>(plan.cap)
                       ? std::max(static_cast<int>(wanted), 2 * now)
                       : plan.cap;
  return std::min(more, plan.cap);
}

void TagAligner::Impl::report_pose() {
  result.counters = problem.counters;
  result.T_map_camera = problem.pose();
  if (problem.motion_prior) {
    report_motion();
  } else {
    const Matrix6d total = solver.information() + problem.prior_information;
    result.covariance = inverse_of_spd(total);
  }
  double gain = 0.0;
  for (const AlignedTag* tag : problem.active) gain += tag->gain;
  if (!problem.active.empty() && gain > 0.0)
    result.residual_rms =
        std::sqrt(solver.variance()) / (gain / static_cast<double>(problem.active.size()));
}

// Reports the covariance of pose and velocity.
void TagAligner::Impl::report_motion() {
  const Matrix12d& prior = problem.motion_prior->information;
  const Matrix12d total = solver.motion_information() + prior;
  const Matrix12d inverse = total.ldlt().solve(Matrix12d::Identity());
  const Matrix12d covariance = 0.5 * (inverse + inverse.transpose());
  result.covariance = covariance.topLeftCorner<6, 6>();
  VelocityEstimate& estimate = result.velocity.emplace();
  estimate.velocity = problem.velocity();
  estimate.covariance = covariance.bottomRightCorner<6, 6>();
  estimate.prior_share = covariance.topRows<6>() * prior * covariance.leftCols<6>();
  estimate.image_information = solver.information();
}

TagAligner::TagAligner(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TagAligner::TagAligner(TagAligner&&) noexcept = default;
TagAligner::~TagAligner() = default;

Result<TagAligner> TagAligner::create(const CameraModel& camera, std::span<const MappedTag> tags,
                                      const AlignmentOptions& options) {
  PENUMBRA_TRY(AlignmentProblem problem, AlignmentProblem::make(camera, tags, options));
  const std::size_t pixels =
      static_cast<std::size_t>(camera.width()) * static_cast<std::size_t>(camera.height());
  const std::size_t initial_floats =
      kFloatsPerSample * std::min(tags.size() * kSamplesPerTag, pixels / kPixelsPerSample);
  return TagAligner(std::make_unique<Impl>(std::move(problem), initial_floats));
}

const AlignmentOptions& TagAligner::options() const {
  return impl_->problem.options;
}
void TagAligner::set_effort(AlignmentEffort effort) {
  impl_->problem.options.effort = effort;
}
void TagAligner::set_tone_exponent(double exponent) {
  impl_->problem.set_tone(exponent);
}
void TagAligner::set_blur(double blur_px) {
  impl_->problem.options.blur_px = blur_px;
}
void TagAligner::set_sample_need(SampleNeed need) {
  impl_->sample_need = std::move(need);
}
AlignmentResult TagAligner::align(const AlignmentInput& input) {
  return impl_->run(input, true);
}
AlignmentResult TagAligner::refine(const AlignmentInput& input) {
  return impl_->run(input, false);
}
std::optional<MapFromCamera> TagAligner::search_pyramid(const AlignmentInput& input, bool further) {
  Impl& m = *impl_;
  m.begin(input);
  if (!m.project_at_prediction() || !m.search.search_pyramid(further)) return std::nullopt;
  const MapFromCamera guess = m.problem.pose();
  return guess.is_finite() ? std::optional(guess) : std::nullopt;
}
MotionBlurError TagAligner::motion_blur_error(const std::optional<Vector6d>& motion, bool known,
                                              double longest_cells) {
  Impl& m = *impl_;
  return MotionBlurCheck(m.problem, m.sampler, m.result.tags, m.agreement.equations(),
                         m.solver.variance())
      .check(motion, known, longest_cells);
}
std::vector<EdgePixel> TagAligner::edge_pixels() {
  return impl_->sampler.edge_pixels(impl_->result.tags);
}

}  // namespace penumbra
