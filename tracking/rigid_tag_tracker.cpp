#include "tracking/rigid_tag_tracker.hpp"

#include <cmath>
#include <utility>

#include "core/assert.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "core/units.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/corner_search.hpp"
#include "tracking/motion/motion_blur.hpp"
#include "tracking/motion/motion_model.hpp"
#include "tracking/motion/pose_history.hpp"
#include "tracking/pose_confidence.hpp"
#include "tracking/rigid_tags.hpp"
#include "tracking/tag_consensus.hpp"

namespace penumbra {
namespace {

// Image motions in 1/30 s [px], RMS over the overlay cube.
constexpr double kRestsBelow_px = 1.0;  // a moving view rests below this
constexpr double kMovesFrom_px = 1.5;   // a resting view moves from this on
constexpr int kFewTags = 3;             // fewer tags are sampled at every pixel
// Image motion in 1/30 s above which blur, not the number of pixels, limits the accuracy [px].
constexpr double kBlurs_px = 12.0;

// State of frame-to-frame tracking; a rejected hint must not change it.
struct Following {
  MotionModel motion;
  TagConsensus consensus;
  bool branch_open = false;  // it is unknown which of a planar target's two poses is tracked
  bool rests = false;
  int last_tags = 0;
  int last_samples = 0;
  bool last_start_far = false;
  double last_contrast = 0.0;  // contrast of the latest alignment; 0: it was not verified
};

// Start of an alignment: the prediction, or TrackRequest::hint without or with hint_seen.
enum class Start { own_motion, hint, seen_hint };

}  // namespace

struct RigidTagTracker::Impl {
  RigidTags group;
  TrackerOptions options;
  TagAligner aligner;
  CornerSearch corners;
  PoseHistory history = {};
  Following state = {};
  SharpResiduals sharp_residuals = {};
  bool found_inconsistent = false;  // the tags found by the latest search are inconsistent
  double map_sigma_m = 0.0;         // AlignmentInput::map_sigma_m
  TrackTimes times = {};

  [[nodiscard]] AssessedPose estimate(const Frame& frame, const TrackRequest& request);
  [[nodiscard]] AssessedPose measure(const Frame& frame, const TrackRequest& request);
  [[nodiscard]] AssessedPose coast(const Frame& frame, PoseReason reason) const;
  // Aligns from `start`; returns nullopt if the result is not verified.
  [[nodiscard]] std::optional<AssessedPose> follow(const Frame& frame, Start start);
  [[nodiscard]] std::optional<AssessedPose> follow_hint(const Frame& frame,
                                                        const MapFromCamera& hint, Start start);
  [[nodiscard]] std::optional<AssessedPose> follow_far(const Frame& frame);
  // Detects tags and estimates the pose from their corners; aligns it if that can be verified.
  [[nodiscard]] AssessedPose find(const Frame& frame, const std::optional<MapFromCamera>& predicted,
                                  SearchResolution finest);

  struct Followed {
    Measurement measurement;
    RefinedPose best;                          // pose of the alignment from the prediction
    Matrix6d filter_covariance;                // covariance of that pose for the motion model
    std::optional<VelocityEstimate> velocity;  // of that alignment
    bool other = false;                        // the second pose fits the image better
  };
  [[nodiscard]] std::optional<Followed> align_followed(const Frame& frame,
                                                       const MotionPrediction& prediction,
                                                       Start start);
  void align_found(const Frame& frame, Measurement& measurement);
  [[nodiscard]] AlignmentInput input_from(const MapFromCamera& pose) const;
  [[nodiscard]] bool has_rolling_shutter() const {
    return group.camera.parameters().rolling_shutter_row_s.value_or(0.0) > 0.0;
  }
  void choose_effort(double motion_px);
  void set_effort(bool every_pixel);
  void record_work(const AlignmentResult& result);
  // Adds the pose's residual to sharp_residuals unless motion may have blurred the image.
  void learn_residual(const RefinedPose& pose, const ImageMotion& image_motion);
};

AssessedPose RigidTagTracker::Impl::coast(const Frame& frame, PoseReason reason) const {
  return {history.coast(group.camera, frame.timestamp_ns, options.hold_s, std::move(reason))};
}

AssessedPose RigidTagTracker::Impl::estimate(const Frame& frame, const TrackRequest& request) {
  if (frame.empty()) return coast(frame, {PoseCause::empty_frame});
  if (frame.width != group.camera.width() || frame.height != group.camera.height()) {
    AssessedPose lost;
    lost.estimate.reason.cause = PoseCause::wrong_size;
    lost.estimate.reason.sizes_px = {frame.width, frame.height, group.camera.width(),
                                     group.camera.height()};
    return lost;
  }
  history.begin_frame(frame.timestamp_ns);
  AssessedPose judged = measure(frame, request);
  const MapPoseEstimate& estimate = judged.estimate;
  if (estimate.status == TrackStatus::lost || estimate.status == TrackStatus::held) return judged;
  const PoseCause cause = estimate.reason.cause;
  const bool is_located = cause != PoseCause::two_poses && cause != PoseCause::inconsistent_tags;
  // Predictions may continue, because a lens error is the same in all frames.
  const bool continues = estimate.status == TrackStatus::tracked || judged.only_lens_uncertain;
  history.add(frame.timestamp_ns, estimate, is_located, continues);
  return judged;
}

AssessedPose RigidTagTracker::Impl::measure(const Frame& frame, const TrackRequest& request) {
  const std::optional<MapFromCamera> predicted = history.recent_prediction(frame.timestamp_ns);
  if (options.mode == TrackingMode::detect) {
    MeasurementResult measurement = corners.detect(group, SearchResolution::full, times);
    if (!measurement) return coast(frame, measurement.error());
    CornerSearch::refine(group, *measurement, times);
    return judge(group, *measurement, predicted);
  }
  MotionModel& motion = state.motion;
  if (motion.has_state() &&
      (frame.timestamp_ns <= motion.timestamp_ns() ||
       seconds(frame.timestamp_ns - motion.timestamp_ns()) > kPriorLifetime_s))
    motion.reset();
  std::optional<AssessedPose> followed = follow(frame, Start::own_motion);
  if (!followed && request.hint && !found_inconsistent)
    followed =
        follow_hint(frame, *request.hint, request.hint_seen ? Start::seen_hint : Start::hint);
  if (!followed && !found_inconsistent) followed = follow_far(frame);
  if (!followed && !request.search) return coast(frame, {PoseCause::not_followed});
  if (request.begins_finest && request.finest == SearchResolution::full)
    corners.begin_at_full_resolution();
  return followed ? *followed : find(frame, predicted, request.finest);
}

void RigidTagTracker::Impl::set_effort(bool every_pixel) {
  times.every_pixel = every_pixel;
  aligner.set_effort(every_pixel ? AlignmentEffort::accurate : AlignmentEffort::fast);
}

void RigidTagTracker::Impl::choose_effort(double motion_px) {
  state.rests = motion_px < (state.rests ? kMovesFrom_px : kRestsBelow_px);
  bool every_pixel = options.mode == TrackingMode::accurate;
  if (options.mode == TrackingMode::automatic) {
    // With a budget, sampling stops when the budget is met.
    every_pixel = state.rests || state.last_tags < kFewTags || options.pose_budget_px > 0.0;
  }
  set_effort(every_pixel && motion_px < kBlurs_px);
}

void RigidTagTracker::Impl::record_work(const AlignmentResult& result) {
  times.samples = state.last_samples = result.counters.samples;
  times.skipped[SkippedWork::out_of_view] = result.counters.tags_out_of_view;
  times.skipped[SkippedWork::too_small] = result.counters.tags_too_small;
  times.skipped[SkippedWork::within_budget] = result.counters.sampling_stopped ? 1 : 0;
  times.skipped[SkippedWork::wide_stage] = result.counters.wide_stage ? 0 : 1;
  const bool fewer_pixels = options.mode == TrackingMode::automatic && !times.every_pixel &&
                            !(options.pose_budget_px > 0.0);
  times.skipped[SkippedWork::while_moving] = fewer_pixels ? 1 : 0;
}

void RigidTagTracker::Impl::learn_residual(const RefinedPose& pose,
                                           const ImageMotion& image_motion) {
  if (image_motion.longest_blur_px() < kBlurs_px && image_motion.blur.shift_px == 0.0)
    sharp_residuals.add(pose.rms_px);
}

// Returns the input of an alignment that starts at `pose`, with an uninformative prior.
AlignmentInput RigidTagTracker::Impl::input_from(const MapFromCamera& pose) const {
  AlignmentInput input;
  input.luma = corners.frame().image();
  input.predicted = pose;
  input.covariance = uninformative_covariance();
  input.rejected = state.consensus.rejected();
  input.map_sigma_m = map_sigma_m;
  return input;
}

std::optional<RigidTagTracker::Impl::Followed> RigidTagTracker::Impl::align_followed(
    const Frame& frame, const MotionPrediction& prediction, Start start) {
  const bool from_hint = start != Start::own_motion;
  const CameraModel& camera = group.camera;
  const double motion_px = image_motion_px(camera, prediction.T_map_camera, prediction.velocity);
  choose_effort(motion_px);
  Alignment alignment{aligner, input_from(prediction.T_map_camera)};
  alignment.input.covariance = prediction.covariance;
  alignment.input.first_samples = state.last_samples;
  alignment.input.starts_far = state.last_start_far;
  alignment.input.previous_contrast = state.last_contrast;
  alignment.input.velocity = prediction.velocity;
  if (has_rolling_shutter())
    alignment.input.velocity_prior =
        from_hint ? unknown_velocity() : state.motion.velocity_prior(frame.timestamp_ns);
  const AlignmentResult& result = alignment.result;
  alignment.run();
  if (result.verified && !from_hint) align_with_measured_motion(history, camera, frame, alignment);
  if (!state.consensus.settle(group, corners.observations(), alignment)) {
    found_inconsistent = true;
    return std::nullopt;
  }
  state.consensus.retest_rejected_seldom(alignment);
  record_work(result);
  state.last_start_far = result.counters.far_start;
  state.last_contrast = result.verified ? result.counters.contrast : 0.0;
  // If few tags at an unconfirmed hint fit, the map may be wrong, which a search would reveal.
  if (start == Start::hint && 3 * result.tags_verified < 2 * result.counters.tags_visible)
    return std::nullopt;
  ImageMotion motion{
      motion_px, 0.0, exposure_of(frame, history.frame_interval_s()), {}, sharp_residuals};
  if (from_hint && result.verified) {
    alignment.input.predicted = result.T_map_camera;
    alignment.input.covariance = uninformative_covariance();
    alignment.with_search = false;
    alignment.run();
    record_work(result);
    motion = estimate_motion(history, camera, frame, alignment, kAlignedBlur_cells);
    motion.sharp = sharp_residuals;
  } else if (result.verified) {
    motion.blur = estimate_motion(history, camera, frame, alignment, kAlignedBlur_cells).blur;
    // Blur and tilt of a few distant tags may look alike.
    if (!state.branch_open &&
        align_with_motion_blur(history, camera, frame, alignment, motion.blur))
      record_work(result);
    motion.unpredicted_px =
        overlay_difference(camera, result.T_map_camera, prediction.T_map_camera).rms_px();
  }
  const std::optional<RefinedPose> best = pose_of(group, alignment, motion);
  if (!best) return std::nullopt;
  learn_residual(*best, motion);
  Followed followed{{}, *best, result.covariance, result.velocity};
  set_aligned_pose(group, alignment, *best, followed.measurement);
  followed.measurement.rejected = state.consensus.rejected();
  state.last_tags = result.tags_verified;
  if (result.tags_verified == 1 || state.branch_open)
    followed.other = add_second_pose(group, alignment, motion, followed.measurement);
  return followed;
}

std::optional<AssessedPose> RigidTagTracker::Impl::follow(const Frame& frame, Start start) {
  if (!state.motion.has_state()) return std::nullopt;
  const MotionPrediction prediction = state.motion.predict(frame.timestamp_ns);
  if (!prediction.T_map_camera.is_finite() || !prediction.covariance.allFinite()) {
    state.motion.reset();
    return std::nullopt;
  }
  const Stopwatch align;
  std::optional<Followed> followed = align_followed(frame, prediction, start);
  align.add_to(times.align_ms, times.align_cpu_ms);
  if (!followed) return std::nullopt;
  Measurement& measurement = followed->measurement;
  std::optional<MapFromCamera> expected = prediction.T_map_camera;
  if (state.branch_open || start != Start::own_motion) {
    expected.reset();
  } else if (followed->other && !measurement.ambiguous) {
    // One image does not outweigh all previous frames: the next frame decides.
    std::swap(measurement.best, *measurement.second);
    measurement.ambiguous = true;
    expected.reset();
  }
  AssessedPose judged = judge(group, measurement, expected);
  const MapPoseEstimate& estimate = judged.estimate;
  state.branch_open = estimate.status == TrackStatus::uncertain && measurement.ambiguous &&
                      estimate.reason.cause == PoseCause::two_poses;
  const MapFromCamera& aligned = followed->best.T_map_camera;
  if (start == Start::own_motion && estimate.T_map_camera.matrix() == aligned.matrix()) {
    if (followed->velocity)
      state.motion.adapt_accelerations(frame.timestamp_ns, *followed->velocity);
    state.motion.update(frame.timestamp_ns, aligned, followed->filter_covariance);
  } else {
    state.motion.start(frame.timestamp_ns, estimate.T_map_camera, estimate.covariance);
  }
  return judged;
}

// Aligns from a hint without a prior.
std::optional<AssessedPose> RigidTagTracker::Impl::follow_hint(const Frame& frame,
                                                               const MapFromCamera& hint,
                                                               Start start) {
  if (!hint.is_finite()) return std::nullopt;
  constexpr double kHint_m = 0.01;
  constexpr double kHint_rad = 0.03;
  const Following before = state;
  state.branch_open = false;
  state.motion.start(frame.timestamp_ns, hint, covariance_of(kHint_m, kHint_rad));
  std::optional<AssessedPose> found = follow(frame, start);
  if (!found) state = before;
  return found;
}

// Tracks a camera that moved beyond the range of the pattern search.
std::optional<AssessedPose> RigidTagTracker::Impl::follow_far(const Frame& frame) {
  if (!state.motion.has_state()) return std::nullopt;
  const MotionPrediction prediction = state.motion.predict(frame.timestamp_ns);
  AlignmentInput input = input_from(prediction.T_map_camera);
  input.velocity = prediction.velocity;
  for (const bool further : {false, true}) {
    const Stopwatch align;
    input.rejected = state.consensus.rejected();
    const std::optional<MapFromCamera> guess = aligner.search_pyramid(input, further);
    align.add_to(times.align_ms, times.align_cpu_ms);
    if (!guess) continue;
    const MotionModel before = state.motion;
    std::optional<AssessedPose> found = follow_hint(frame, *guess, Start::hint);
    if (!found) {
      found_inconsistent = false;  // resets the flag, because the guess may be wrong
      continue;
    }
    times.pyramid_search = true;
    if (!state.branch_open) {
      state.motion = before;
      state.motion.update(frame.timestamp_ns, found->estimate.T_map_camera,
                          found->estimate.covariance);
    }
    return found;
  }
  return std::nullopt;
}

void RigidTagTracker::Impl::align_found(const Frame& frame, Measurement& measurement) {
  // Without a velocity, the view is treated as moving.
  set_effort(options.mode == TrackingMode::accurate ||
             (options.mode == TrackingMode::automatic &&
              (measurement.tags_used < kFewTags || options.pose_budget_px > 0.0)));
  TagConsensus& consensus = state.consensus;
  consensus.begin(measurement.rejected);
  Alignment alignment{aligner, input_from(measurement.best.T_map_camera), false};
  if (has_rolling_shutter()) alignment.input.velocity_prior = unknown_velocity();
  alignment.run();
  consensus.retest_rejected(alignment);
  measurement.inconsistent = !consensus.settle(group, corners.observations(), alignment);
  measurement.rejected = consensus.rejected();
  const AlignmentResult& result = alignment.result;
  record_work(result);
  ImageMotion motion =
      estimate_motion(history, group.camera, frame, alignment, kDetectedBlur_cells);
  motion.sharp = sharp_residuals;
  const std::optional<RefinedPose> best = pose_of(group, alignment, motion);
  if (best) {
    learn_residual(*best, motion);
    set_aligned_pose(group, alignment, *best, measurement);
    state.last_tags = result.tags_verified;
    // Uses every pixel until the velocity is known, except in rounds that start far away.
    state.last_start_far = options.mode == TrackingMode::automatic && state.last_tags >= kFewTags &&
                           result.counters.far_start;
    // Few or small tags that face the camera may have a second pose that their corners don't
    // reveal.
    constexpr double kUnsure_px = 0.5;
    if (measurement.ambiguous || state.last_tags == 1 ||
        predicted_overlay_error_px(group.camera, best->T_map_camera, best->covariance) >
            kUnsure_px) {
      add_second_pose(group, alignment, motion, measurement);
    } else {
      measurement.second.reset();
    }
  }
  if (measurement.inconsistent) {
    consensus.count_strict_frame();
  } else {
    consensus.end_strict_frames();
  }
}

AssessedPose RigidTagTracker::Impl::find(const Frame& frame,
                                         const std::optional<MapFromCamera>& predicted,
                                         SearchResolution finest) {
  MeasurementResult measurement = corners.find(group, finest, predicted, times);
  if (!measurement) return coast(frame, measurement.error());
  if (measurement->inconsistent) {
    state.consensus.begin_strict_frames();
  } else {
    const Stopwatch align;
    align_found(frame, *measurement);
    align.add_to(times.align_ms, times.align_cpu_ms);
  }
  CornerSearch::refine(group, *measurement, times);
  times.skipped[SkippedWork::corner_solve] = measurement->by_ceres ? 0 : 1;
  AssessedPose judged = judge(group, *measurement, predicted);
  const MapPoseEstimate& estimate = judged.estimate;
  found_inconsistent = measurement->inconsistent;
  if (found_inconsistent) {
    state.motion.reset();
    return judged;
  }
  const bool was_open =
      std::exchange(state.branch_open, estimate.reason.cause == PoseCause::two_poses);
  if (state.motion.has_state() && !was_open && !state.branch_open) {
    state.motion.update(frame.timestamp_ns, estimate.T_map_camera, estimate.covariance);
  } else {
    state.motion.start(frame.timestamp_ns, estimate.T_map_camera, estimate.covariance);
  }
  if (estimate.status == TrackStatus::tracked) corners.begin_at_low_resolution();
  return judged;
}

void RigidTagTracker::set_map_sigma(double sigma_m) {
  impl_->map_sigma_m = sigma_m;
}

RigidTagTracker::RigidTagTracker(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RigidTagTracker::RigidTagTracker(RigidTagTracker&&) noexcept = default;
RigidTagTracker& RigidTagTracker::operator=(RigidTagTracker&&) noexcept = default;
RigidTagTracker::~RigidTagTracker() = default;

Result<RigidTagTracker> RigidTagTracker::create(const CameraModel& camera, const TagMap& tags,
                                                std::string_view group,
                                                const TrackerOptions& options,
                                                std::shared_ptr<TagSearch> search) {
  PENUMBRA_ASSERT(search != nullptr);
  if (!(options.hold_s >= 0.0) || !std::isfinite(options.pose_budget_px) ||
      options.pose_budget_px < 0.0)
    return fail("tracker options: every limit must be a positive number");
  RigidTags rigid{camera, {}};
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group == group) rigid.tags.push_back(tag);
  }
  PENUMBRA_ASSERT(!rigid.tags.empty());
  PENUMBRA_TRY(TagAligner aligner, TagAligner::create(camera, rigid.tags));
  if (options.pose_budget_px > 0.0) {
    aligner.set_sample_need(
        [camera, budget_px = options.pose_budget_px](const AlignmentResult& result) {
          return samples_needed(camera, result, budget_px);
        });
  }
  return RigidTagTracker(std::make_unique<Impl>(
      Impl{std::move(rigid), options, std::move(aligner), CornerSearch(tags, std::move(search))}));
}

TrackedTags RigidTagTracker::track(const Frame& frame, const TrackRequest& request) {
  impl_->times = {};
  return {impl_->estimate(frame, request).estimate, impl_->times};  // evaluated in this order
}

MapPoseEstimate RigidTagTracker::locate(std::span<const TagDetection> detections) {
  Impl& m = *impl_;
  MeasurementResult measurement = m.corners.measure(m.group, detections, m.times);
  if (!measurement) {
    MapPoseEstimate lost;
    lost.reason = measurement.error();
    return lost;
  }
  CornerSearch::refine(m.group, *measurement, m.times);
  m.found_inconsistent = measurement->inconsistent;
  return judge(m.group, *measurement, std::nullopt).estimate;
}

}  // namespace penumbra
