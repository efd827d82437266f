#include "tracking/table_tracker.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <utility>
#include <vector>

#include "core/assert.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "core/units.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/detection/board_pose.hpp"
#include "tracking/motion/motion_model.hpp"
#include "tracking/motion/spd6.hpp"

namespace penumbra {
namespace {

// How long a measured pose still says where the camera is now, well enough to choose between two
// poses or to give a velocity.
constexpr double kPriorLifetime_s = 0.2;

// Image motion in a thirtieth of a second [px], RMS over the overlay cube: below the first the view
// rests, above the second it moves again.
constexpr double kRests_px = 1.0;
constexpr double kMoves_px = 1.5;
constexpr int kFewTags = 3;  // with less than these every pixel counts
// From here on motion blur, of half a frame, is wider than the lens's own by so much that more
// pixels only repeat its error.
constexpr double kBlurs_px = 12.0;

// What the alignment's own covariance, of independent residuals and a true model, doesn't know.
// None of it was fitted to a recording; tests/benchmarks/honesty_benchmark.cpp holds the sum
// against random synthetic sessions.
//
// The model of the picture is not exact (point spread, what is next to an edge), and misses all
// edges of a tag together by some thousandths of a pixel, against which more samples do not help:
// 0.003 px on exact pictures without noise. Over random synthetic sessions (seeds 1 to 130 of the
// benchmark; other lenses, point spreads and tone curves than the model's) 0.01 px is what the
// layout that feels it most, six tags in a line, needs for errors of the size expected.
constexpr double kTagBias_px = 0.01;
// A point spread that is not what it is taken for displaces an edge only with the help of the next
// one, half a cell from the point between them: by this [px], though no more than residuals show,
// times how much of an edge's spread reaches there. A tag's edges go together in some eight parts.
constexpr double kSpreadBias_px = 0.1;
constexpr double kPartsOfTag = 8.0;
// With a tone curve that is not known, all edges of all tags: 0.04 px of overlay on an exact
// picture coded as sRGB.
constexpr double kToneBias_px = 0.04;
// The picture shows the mean of the poses during the exposure, the pose is that of its middle. With
// the acceleration a they are a e^2 / 24 apart; a prediction at constant velocity over the time T
// misses by a T^2; and e, which is not known, is at most T.
constexpr double kExposureShare = 1.0 / 24.0;
// Blur of length b spreads an edge with a sigma of b / sqrt(12), b at most the image's motion in a
// frame. It may displace all edges together, though by no more than that sigma, nor by more than
// the residuals, taken as a displacement, show.
constexpr double kBlurShare = 0.288675134594813;

// The image's motion in a frame, RMS over the overlay cube [px].
struct ImageMotion {
  double predicted = 0.0;
  double missed = 0.0;  // what a prediction at constant velocity missed
  SmearError smear;     // what it may have done to the picture
};
const ImageMotion kUnknownMotion{5.0, 5.0, {}};  // of a frame with none before it

// In a frame, as perturbations of its pose per second.
struct CameraMotion {
  Vector6d velocity;
  Vector6d change;  // of it, since the frame before; all of it where there is but one
  bool of_one_step = true;
};

// The longest smears over which tags are read, by libapriltag and by the alignment.
constexpr double kDetected_cells = 2.0;
constexpr double kAligned_cells = 5.0;

// Log-likelihood of one of two poses over the other, from which on the picture decides: half of the
// chi-square of BoardPose::is_ambiguous.
constexpr double kDecides = 9.0;

// ... but never between two that put the tags' corners nearer to each other than this [px], nor,
// where cells are smaller than so many sigmas of the point spread and their edges run together,
// than so many times what residuals, taken as a displacement, show: what the model of the picture
// misses (point spread, tone curve, pixels) is the same for all pixels of an edge, and their number
// makes it no smaller. Of 7380 random pictures of a lone tag, 8 to 130 px wide, whose two poses are
// 2 px of overlay apart and more, likelihood alone told 5950 apart and 105 of them wrongly, of tags
// as wide as 21 px; with these limits 5234 and 3.
constexpr double kSame_px = 0.15;
constexpr double kSameResiduals = 2.0;
constexpr double kRunTogether_sigmas = 5.0;

// Of a pose from elsewhere that only says where to begin.
Matrix6d loose_covariance() {
  Matrix6d covariance = Matrix6d::Zero();
  covariance.diagonal().head<3>().setConstant(0.05 * 0.05);
  covariance.diagonal().tail<3>().setConstant(0.1 * 0.1);
  return covariance;
}

// What one frame says about the pose, whatever method found it.
struct Measurement {
  RefinedPose best;
  std::optional<RefinedPose> second;
  BoardPose by_corners;   // what these are where they are not aligned
  bool by_ceres = false;  // whether that was solved for by Ceres
  double ambiguity_ratio = std::numeric_limits<double>::infinity();
  int tags_used = 0;
  std::vector<int> left_out;  // in the aligner's order
  bool ambiguous = false;     // the second pose may be the true one
  bool contradictory = false;
  bool aligned = false;          // by the alignment: the covariance is what it should be
  double samples_for_one = 1.0;  // of an alignment; see the function of this name
  double map_px = 0.0;           // of the overlay, what a map that the tags contradict may do to it
};

// How many times larger the covariance is than that of independent residuals about a true model.
struct CovarianceTimes {
  double scatter = 1.0;  // by residuals that go together, and tags that disagree
  double bias = 0.0;     // on top of it, by what displaces a tag as a whole, in every frame alike
};

// The bias of a tag turns the pose against the other tags; a lone one it takes along by no more
// than itself, but where its cells are small against the point spread.
CovarianceTimes covariance_times(const AlignmentResult& result, double blur_px, double noise_px) {
  CovarianceTimes times;
  // How far the tags disagree says what a part of it is worth.
  times.scatter = samples_for_one(result);
  if (result.map_covariance.isZero(0.0))
    times.scatter = std::max(times.scatter, result.disagreement);
  if (result.tags_verified == 0 || !(noise_px > 0.0)) return times;
  double bias2 = result.tags_verified > 1 ? kTagBias_px * kTagBias_px : 0.0;
  const double spread_px = std::min(kSpreadBias_px, noise_px);
  for (const TagAlignment& tag : result.tags) {
    if (!tag.verified) continue;
    const double reach = std::exp(-std::pow(tag.cell_px / blur_px, 2) / 8.0);
    bias2 += std::pow(spread_px * reach, 2) / (kPartsOfTag * result.tags_verified);
  }
  times.bias = bias2 / (noise_px * noise_px) * result.counters.samples / result.tags_verified;
  return times;
}

struct TimedPose {
  std::int64_t timestamp_ns = 0;
  CameraPose pose;
  Matrix6d covariance = Matrix6d::Zero();
  bool tracked = false;
};

struct ModeName {
  std::string_view name;
  TrackingMode mode;
};
constexpr std::array<ModeName, 4> kModes = {{{"detect", TrackingMode::detect},
                                             {"fast", TrackingMode::fast},
                                             {"accurate", TrackingMode::accurate},
                                             {"auto", TrackingMode::automatic}}};

// Of frame to frame tracking: what a guess that turned out wrong must leave as it was.
struct Following {
  MotionModel motion;
  bool branch_open = false;  // which of a lone tag's two poses is followed is not known
  bool rests = false;
  int last_tags = 0;
  int last_samples = 0;
  bool last_start_far = false;
  double last_contrast = 0.0;  // of the last alignment that was verified with a search
  // Tags that contradict the others, in the aligner's order, and for how many frames they have
  // been left out: then they are looked at again.
  std::vector<int> left_out;
  int frames_without = 0;
  int frames_unasked = 0;  // in which all tags disagreed, and were not asked one by one
};

}  // namespace

std::string_view to_string(TrackingMode mode) {
  for (const ModeName& entry : kModes) {
    if (entry.mode == mode) return entry.name;
  }
  return "auto";
}

std::optional<TrackingMode> tracking_mode_from_string(std::string_view name) {
  for (const ModeName& entry : kModes) {
    if (entry.name == name) return entry.mode;
  }
  return std::nullopt;
}

struct TableTracker::Impl : Following {
  Impl(CameraModel camera_, TagMap tags_, TrackerOptions options_,
       std::shared_ptr<TagSearch> search_, TagAligner aligner_, std::vector<MappedTag> table_tags_)
      : camera(std::move(camera_)),
        tags(std::move(tags_)),
        options(options_),
        search(std::move(search_)),
        aligner(std::move(aligner_)),
        table_tags(std::move(table_tags_)) {
    if (options.pose_budget_px > 0.0) {
      // Of the tracker on the heap: it is moved with what holds it.
      aligner.set_sample_need(
          [this](const AlignmentResult& result) { return samples_needed(result); });
    }
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  CameraModel camera;
  TagMap tags;
  TrackerOptions options;
  std::shared_ptr<TagSearch> search;
  TagAligner aligner;
  std::vector<MappedTag> table_tags;  // in the aligner's order

  // The last two tracked poses, newest first.
  std::optional<TimedPose> last;
  std::optional<TimedPose> before_last;
  // The last two measured ones, tracked or uncertain, but for those that may be elsewhere
  // altogether (two poses, or tags that contradict each other): they say nothing of how the camera
  // moved.
  std::optional<TimedPose> measured;
  std::optional<TimedPose> before_measured;
  TrackStatus last_status = TrackStatus::tracked;  // of the last frame that was measured
  // From the frame before to this one, no longer than which it was exposed; 0: unknown.
  double frame_interval_s = 0.0;
  std::optional<std::int64_t> frame_before_ns;

  bool full_next = false;  // at which resolution is searched next
  bool searched_before = false;
  // The last search found tags that contradict each other: where the pattern fits here and there
  // says nothing.
  bool contradicted = false;
  int frames_doubtful = 0;  // searches after one of these that want more than a pose
  // The last judged pose is uncertain because the lens is.
  bool lens_alone_uncertain = false;
  // Of the last search that was measured; their ids are places in table_tags, for tags of several
  // families may have the same ids.
  std::vector<TagObservation> observations;

  TrackTimes times;

  // Where an alignment begins: where the last frames say, or where somebody else does, who has seen
  // tags there or not.
  enum class Start { own_motion, hint, seen_hint };

  [[nodiscard]] std::optional<CameraPose> predict(std::int64_t timestamp_ns) const;
  [[nodiscard]] Result<Measurement> measure(std::span<const TagDetection> detections);
  void take_corners(Measurement& measurement) const;
  void solve_by_ceres(Measurement& measurement);
  [[nodiscard]] Result<Measurement> measure_by_detection(SearchResolution resolution);
  [[nodiscard]] bool shows_most(const Measurement& measurement) const;
  [[nodiscard]] std::optional<PixelBox> box_about(const CameraPose& pose) const;
  [[nodiscard]] Result<Measurement> measure_by_search(SearchResolution finest,
                                                      const std::optional<CameraPose>& predicted);
  [[nodiscard]] double image_motion_px(const MotionPrediction& prediction) const;
  void choose_effort(double motion_px);
  [[nodiscard]] double samples_needed(const AlignmentResult& result) const;
  [[nodiscard]] std::optional<RefinedPose> aligned(const AlignmentResult& result,
                                                   const Matrix6d& prior,
                                                   const ImageMotion& motion_px) const;
  void take(const RefinedPose& pose, const AlignmentResult& result, Measurement& measurement) const;
  [[nodiscard]] double apart_px(const CameraPose& a, const CameraPose& b,
                                std::span<const TagAlignment> seen) const;
  [[nodiscard]] CameraPose mirrored(const CameraPose& pose,
                                    std::span<const TagAlignment> seen) const;
  bool add_second(const AlignmentInput& of_first, const ImageMotion& image_motion,
                  const AlignmentResult& first, Measurement& measurement);
  [[nodiscard]] ImageMotion motion_found(const Frame& frame, const AlignmentResult& result,
                                         double longest_smear_cells);
  void align_by_smear(const Frame& frame, AlignmentInput& input, AlignmentResult& result,
                      SmearError& smear);
  void note_work(const AlignmentResult& result);
  [[nodiscard]] bool is_doubtful(const AlignmentResult& result, bool with_search) const;
  [[nodiscard]] bool may_leave_out(const AlignmentResult& result) const;
  [[nodiscard]] AlignmentResult align_without(AlignmentInput& input, std::span<const int> without,
                                              bool with_search);
  void leave_one_out(AlignmentInput& input, AlignmentResult& result);
  [[nodiscard]] double scatter_px(const AlignmentResult& joint, const AlignmentInput& input);
  [[nodiscard]] bool settle(AlignmentInput& input, AlignmentResult& result, bool with_search);
  void look_again(AlignmentInput& input, AlignmentResult& result, bool with_search);
  [[nodiscard]] std::optional<CameraMotion> motion_at(std::int64_t timestamp_ns,
                                                      const CameraPose& pose) const;
  void align_at_own_speed(const Frame& frame, AlignmentInput& input, AlignmentResult& result);
  [[nodiscard]] std::optional<PoseEstimate> follow(const Frame& frame, ImageView image,
                                                   Start start = Start::own_motion);
  [[nodiscard]] std::optional<PoseEstimate> follow_hint(const Frame& frame, ImageView image,
                                                        const CameraPose& hint, Start start);
  [[nodiscard]] std::optional<PoseEstimate> follow_far(const Frame& frame, ImageView image);
  [[nodiscard]] PoseEstimate find(const Frame& frame, ImageView image,
                                  const std::optional<CameraPose>& predicted,
                                  SearchResolution finest);
  [[nodiscard]] int tags_in_view(const CameraPose& pose) const;
  [[nodiscard]] PoseEstimate judge(const Measurement& measurement,
                                   const std::optional<CameraPose>& predicted);
  [[nodiscard]] PoseEstimate without_measurement(std::int64_t timestamp_ns,
                                                 std::string reason) const;
  [[nodiscard]] PoseEstimate estimate(const Frame& frame, const SharedFrame& shared);
};

// The last motion continued at constant velocity, as a rotation about an axis (quaternions) and a
// translation in the camera's own axes.
std::optional<CameraPose> TableTracker::Impl::predict(std::int64_t timestamp_ns) const {
  if (!last) return std::nullopt;
  if (!before_last) return last->pose;
  const double step_s = seconds(last->timestamp_ns - before_last->timestamp_ns);
  if (!(step_s > 0.0) || step_s > kPriorLifetime_s) return last->pose;
  const double ahead_s = seconds(timestamp_ns - last->timestamp_ns);
  const Vector6d xi = perturbation_between(before_last->pose, last->pose);
  return perturbed(last->pose, xi * (ahead_s / step_s));
}

Result<Measurement> TableTracker::Impl::measure_by_detection(SearchResolution resolution) {
  const bool again = search->searched(resolution);
  const Stopwatch detect;
  const std::vector<TagDetection>& detections = search->tags(resolution);
  if (!again) {  // else it counts where it was done
    detect.add_to(times.detect_ms, times.detect_cpu_ms);
    times.full_detection = true;
  }
  return measure(detections);
}

Result<Measurement> TableTracker::Impl::measure(std::span<const TagDetection> detections) {
  const Stopwatch solve;
  observations.clear();
  bool seen_twice = false;
  int strangers = 0;  // that the map does not have
  for (std::size_t i = 0; i < detections.size(); ++i) {
    const TagDetection& detection = detections[i];
    const MappedTag* tag = tags.find(detection.family, detection.id);
    if (tag == nullptr) ++strangers;
    // Another group is rigid in itself but may stand elsewhere on the table by now.
    if (tag == nullptr || tag->group != kTableGroup) continue;
    const auto same = [&](const TagDetection& other) {
      return other.family == detection.family && other.id == detection.id;
    };
    if (std::count_if(detections.begin(), detections.end(), same) > 1) {
      seen_twice = true;  // nothing says which of them lies where the map has it
      continue;
    }
    const auto known = std::ranges::find_if(table_tags, [tag](const MappedTag& of_table) {
      return of_table.family == tag->family && of_table.id == tag->id;
    });
    const auto index = static_cast<int>(known - table_tags.begin());
    observations.push_back({index, tag->corners(), detection.corners_px});
  }
  Result<BoardPose> board = estimate_board_pose(camera, observations);
  solve.add_to(times.solve_ms, times.solve_cpu_ms);
  if (!board) {
    if (observations.empty() && seen_twice) return fail("the same tag is in view twice");
    // One alone may be a pattern that happens to look like a tag.
    if (observations.empty() && strangers > 1) {
      return fail("{} tags in view, none of them of this board (--tags)", strangers);
    }
    return tl::unexpected(board.error());
  }
  Measurement measurement;
  measurement.by_corners = std::move(*board);
  take_corners(measurement);
  measurement.tags_used = measurement.by_corners.tags_used;
  measurement.contradictory = measurement.by_corners.contradictory;
  measurement.left_out = measurement.by_corners.left_out;
  if (measurement.best.rms_px > options.max_reprojection_rms_px)
    return fail("{} ({:.1f} px)", kNotFitting, measurement.best.rms_px);
  return measurement;
}

void TableTracker::Impl::take_corners(Measurement& measurement) const {
  const BoardPose& board = measurement.by_corners;
  measurement.best = board.best;
  measurement.second = board.second;
  measurement.ambiguity_ratio = board.ambiguity_ratio();
  measurement.ambiguous = board.is_ambiguous(options.ambiguity_ratio);
}

// What is to be judged by its corners alone.
void TableTracker::Impl::solve_by_ceres(Measurement& measurement) {
  if (measurement.aligned || std::exchange(measurement.by_ceres, true)) return;
  const Stopwatch solve;
  finish_by_ceres(camera, measurement.by_corners);
  take_corners(measurement);
  solve.add_to(times.solve_ms, times.solve_cpu_ms);
}

// Tags of the table that lie wholly inside the image under this pose, are seen from in front, and
// are large enough to be read.
int TableTracker::Impl::tags_in_view(const CameraPose& pose) const {
  constexpr double kMargin = 4.0;          // [px] white around the black square
  constexpr double kSmallestArea = 200.0;  // [px^2]: 8 cells and a bit less than 2 px each
  const auto T_camera_table = pose.inverse();
  int count = 0;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group != kTableGroup) continue;
    std::array<Eigen::Vector2d, 4> corners;
    bool inside = true;
    const std::array<Eigen::Vector3d, 4> corners_table = tag.corners();
    for (std::size_t i = 0; i < 4 && inside; ++i) {
      const std::optional<Eigen::Vector2d> pixel =
          camera.project(T_camera_table * corners_table[i]);
      inside = pixel && pixel->x() >= kMargin && pixel->y() >= kMargin &&
               pixel->x() <= camera.width() - 1 - kMargin &&
               pixel->y() <= camera.height() - 1 - kMargin;
      if (inside) corners[i] = *pixel;
    }
    if (!inside) continue;
    const Eigen::Vector2d a = corners[2] - corners[0];
    const Eigen::Vector2d b = corners[3] - corners[1];
    // Half the cross product of the diagonals; negative from in front, because rows count down.
    if (-0.5 * (a.x() * b.y() - a.y() * b.x()) >= kSmallestArea) ++count;
  }
  return count;
}

PoseEstimate TableTracker::Impl::judge(const Measurement& measurement,
                                       const std::optional<CameraPose>& predicted) {
  RefinedPose chosen = measurement.best;
  bool open = false;
  double between_px = 0.0;  // what the other pose would do to the overlay, where it stays possible
  if (measurement.second) {
    const RefinedPose& second = *measurement.second;
    if (measurement.ambiguous) {
      between_px =
          overlay_difference(camera, measurement.best.T_table_camera, second.T_table_camera)
              .rms_px();
      open = between_px > options.tracked_overlay_px;
      if (open && predicted) {
        const double best_px =
            overlay_difference(camera, measurement.best.T_table_camera, *predicted).rms_px();
        const double second_px =
            overlay_difference(camera, second.T_table_camera, *predicted).rms_px();
        constexpr double kClearly = 3.0;
        if (best_px * kClearly < second_px) {
          open = false;
        } else if (second_px * kClearly < best_px) {
          open = false;
          chosen = second;
        }
        if (!open) between_px = 0.0;
      }
    }
  }
  PoseEstimate estimate;
  estimate.T_table_camera = chosen.T_table_camera;
  // Where most of the tags that should be readable are not, the picture is blurred or the view
  // grazing, and the corners that did come out are displaced together: their residuals don't show
  // it (strong shake: overlay errors of 4 times what they promise). The share of unread tags does.
  const double share = measurement.aligned
                           ? 1.0
                           : static_cast<double>(std::max(tags_in_view(chosen.T_table_camera), 1)) /
                                 static_cast<double>(std::max(measurement.tags_used, 1));
  estimate.covariance = chosen.covariance * std::max(share, 1.0);
  estimate.reprojection_rms_px = chosen.rms_px;
  estimate.ambiguity_ratio = measurement.ambiguity_ratio;
  estimate.tags_used = measurement.tags_used;
  for (const int index : measurement.left_out)
    estimate.tags_left_out.push_back(table_tags[static_cast<std::size_t>(index)].id);
  const double of_pose_px = std::hypot(
      expected_overlay_error_px(camera, chosen.T_table_camera, estimate.covariance), between_px);
  estimate.expected_overlay_error_px = with_lens_error_px(camera, of_pose_px);
  estimate.status = TrackStatus::uncertain;
  lens_alone_uncertain = false;
  if (measurement.contradictory) {
    estimate.reason = kContradicting;
  } else if (open) {
    estimate.reason = kTwoPoses;
  } else if (!(estimate.expected_overlay_error_px < options.tracked_overlay_px)) {
    if (!std::isfinite(estimate.expected_overlay_error_px)) {
      estimate.reason = "the table's centre is out of sight";
    } else if (of_pose_px < options.tracked_overlay_px) {
      lens_alone_uncertain = true;
      estimate.reason = fmt::format(
          "the camera file knows its lens to {:.1f} px only; calibrate it from more views",
          camera.parameters().overlay_sigma_px.value_or(0.0));
    } else if (of_pose_px * of_pose_px - measurement.map_px * measurement.map_px <
               options.tracked_overlay_px * options.tracked_overlay_px) {
      estimate.reason =
          fmt::format("the few tags in view do not lie as the map says: expected error {:.1f} px",
                      estimate.expected_overlay_error_px);
    } else {
      estimate.reason = fmt::format("expected error {:.1f} px", estimate.expected_overlay_error_px);
    }
  } else {
    estimate.status = TrackStatus::tracked;
  }
  return estimate;
}

PoseEstimate TableTracker::Impl::without_measurement(std::int64_t timestamp_ns,
                                                     std::string reason) const {
  PoseEstimate estimate;
  estimate.reason = std::move(reason);
  if (!last) return estimate;
  const double age_s = seconds(timestamp_ns - last->timestamp_ns);
  if (!(age_s >= 0.0) || age_s > options.hold_s) return estimate;
  const std::optional<CameraPose> predicted = predict(timestamp_ns);
  if (!predicted || !predicted->is_finite()) return estimate;
  estimate.status = TrackStatus::held;
  estimate.held_from = last_status;
  estimate.T_table_camera = *predicted;
  estimate.age_s = age_s;
  estimate.ambiguity_ratio = std::numeric_limits<double>::infinity();
  estimate.covariance = last->covariance + unforeseen_motion(age_s);
  estimate.expected_overlay_error_px = with_lens_error_px(
      camera, expected_overlay_error_px(camera, estimate.T_table_camera, estimate.covariance));
  return estimate;
}

PoseEstimate TableTracker::Impl::estimate(const Frame& frame, const SharedFrame& shared) {
  if (frame.empty()) return without_measurement(frame.timestamp_ns, "the frame is empty");
  if (frame.width != camera.width() || frame.height != camera.height()) {
    PoseEstimate lost;
    lost.reason = fmt::format("the frame is {}x{}, the camera file says {}x{}", frame.width,
                              frame.height, camera.width(), camera.height());
    return lost;
  }
  // A clock that jumps back or far ahead leaves nothing of the past to rely on.
  if (last && frame.timestamp_ns <= last->timestamp_ns) {
    last.reset();
    before_last.reset();
  }
  if (measured && frame.timestamp_ns <= measured->timestamp_ns) {
    measured.reset();
    before_measured.reset();
  }
  frame_interval_s = 0.0;
  if (frame_before_ns)
    frame_interval_s = std::max(seconds(frame.timestamp_ns - *frame_before_ns), 0.0);
  frame_before_ns = frame.timestamp_ns;
  const bool recent = last && seconds(frame.timestamp_ns - last->timestamp_ns) <= kPriorLifetime_s;
  const std::optional<CameraPose> predicted = recent ? predict(frame.timestamp_ns) : std::nullopt;
  PoseEstimate estimate;
  if (options.mode == TrackingMode::detect) {
    Result<Measurement> measurement = measure_by_detection(SearchResolution::full);
    if (!measurement) return without_measurement(frame.timestamp_ns, measurement.error().message);
    solve_by_ceres(*measurement);
    estimate = judge(*measurement, predicted);
  } else {
    if (motion.has_state() &&
        (frame.timestamp_ns <= motion.timestamp_ns() ||
         seconds(frame.timestamp_ns - motion.timestamp_ns()) > kPriorLifetime_s))
      motion.reset();
    const ImageView image = search->image();
    std::optional<PoseEstimate> followed = follow(frame, image);
    if (!followed && shared.hint && !contradicted)
      followed = follow_hint(frame, image, *shared.hint,
                             shared.hint_seen ? Start::seen_hint : Start::hint);
    if (!followed && !contradicted) followed = follow_far(frame, image);
    if (!followed && !shared.search)
      return without_measurement(frame.timestamp_ns, "not where it was");
    if (shared.begins_finest && shared.finest == SearchResolution::full) full_next = true;
    estimate = followed ? *followed : find(frame, image, predicted, shared.finest);
    if (estimate.status == TrackStatus::lost || estimate.status == TrackStatus::held)
      return estimate;
  }
  last_status = estimate.status;
  const TimedPose here{frame.timestamp_ns, estimate.T_table_camera, estimate.covariance,
                       estimate.status == TrackStatus::tracked};
  if (estimate.reason != kTwoPoses && estimate.reason != kContradicting)
    before_measured = std::exchange(measured, here);
  // What can be continued: a lens that is hardly known is the same in all frames.
  if (estimate.status == TrackStatus::tracked || lens_alone_uncertain) {
    before_last = std::exchange(last, here);
  }
  return estimate;
}

// How far the overlay goes in a thirtieth of a second, as predicted.
double TableTracker::Impl::image_motion_px(const MotionPrediction& prediction) const {
  constexpr double kFrame_s = 1.0 / 30.0;
  return overlay_difference(camera,
                            perturbed(prediction.T_table_camera, kFrame_s * prediction.velocity),
                            prediction.T_table_camera)
      .rms_px();
}

void TableTracker::Impl::choose_effort(double motion_px) {
  rests = motion_px < (rests ? kMoves_px : kRests_px);
  bool every_pixel = options.mode == TrackingMode::accurate;
  if (options.mode == TrackingMode::automatic) {
    // A budget says itself when it is enough.
    every_pixel = rests || last_tags < kFewTags || options.pose_budget_px > 0.0;
  }
  times.every_pixel = every_pixel && motion_px < kBlurs_px;
  aligner.set_effort(times.every_pixel ? AlignmentEffort::accurate : AlignmentEffort::fast);
}

// By their noise alone: what the model of the picture misses, no number of pixels mends. A part of
// the budget that the tone curve takes is not theirs.
double TableTracker::Impl::samples_needed(const AlignmentResult& result) const {
  const double noise_px =
      std::sqrt(samples_for_one(result)) *
      expected_overlay_error_px(camera, result.T_table_camera, result.covariance);
  const double tone_px = camera.parameters().tone_curve ? 0.0 : kToneBias_px;
  const double left = options.pose_budget_px * options.pose_budget_px - tone_px * tone_px;
  if (!(left > 0.0) || !std::isfinite(noise_px)) return std::numeric_limits<double>::infinity();
  return noise_px * noise_px / left;
}

// The alignment's pose with a covariance that says what it is worth in the image.
// `prior`: the prediction's covariance, as it was given to the alignment.
std::optional<RefinedPose> TableTracker::Impl::aligned(const AlignmentResult& result,
                                                       const Matrix6d& prior,
                                                       const ImageMotion& motion_px) const {
  if (!result.verified || !result.T_table_camera.is_finite() || !result.covariance.allFinite())
    return std::nullopt;
  RefinedPose pose;
  pose.T_table_camera = result.T_table_camera;
  // As a displacement of the edges: a blurred edge rises by 1 / (sqrt(2 pi) sigma) of the gain per
  // pixel. Two axes.
  pose.noise_px =
      result.residual_rms * std::sqrt(2.0 * std::numbers::pi) * aligner.options().blur_px;
  pose.rms_px = std::sqrt(2.0) * pose.noise_px;
  // The alignment weighs image (information H) and prediction (P^-1) with A = H + P^-1. If the
  // image's errors have F times the covariance it took them to have, the estimate's covariance is
  // A^-1 (F H + P^-1) A^-1 = F A^-1 - (F - 1) A^-1 P^-1 A^-1. A bias is in the frames before this
  // one, too: predictions made of them hold nothing against it, and it moves the pose by what the
  // image alone would let it. Where that knows nothing of a direction, a metre and a radian.
  const CovarianceTimes larger = covariance_times(result, aligner.options().blur_px, pose.noise_px);
  const Matrix6d& inverse = result.covariance;
  const Matrix6d prior_information = inverse_of_spd(prior);
  pose.covariance = larger.scatter * inverse -
                    (larger.scatter - 1.0) * (inverse * prior_information * inverse).eval();
  if (larger.bias > 0.0) {
    const Matrix6d of_image = inverse_of_spd(inverse) - prior_information;
    pose.covariance += larger.bias * inverse_of_spd(of_image + Matrix6d::Identity());
  }
  pose.covariance += result.map_covariance + motion_px.smear.covariance;
  pose.covariance = 0.5 * (pose.covariance + pose.covariance.transpose()).eval();
  const double promised = expected_overlay_error_px(camera, result.T_table_camera, pose.covariance);
  if (promised > 0.0 && std::isfinite(promised)) {
    const double blur_px =
        std::min(kBlurShare * std::hypot(motion_px.predicted, motion_px.missed), pose.rms_px);
    const double systematic_px = std::hypot(camera.parameters().tone_curve ? 0.0 : kToneBias_px,
                                            kExposureShare * motion_px.missed,
                                            std::hypot(blur_px, motion_px.smear.shift_px));
    pose.covariance *= 1.0 + systematic_px * systematic_px / (promised * promised);
  }
  return pose;
}

void TableTracker::Impl::take(const RefinedPose& pose, const AlignmentResult& result,
                              Measurement& measurement) const {
  measurement.best = pose;
  measurement.aligned = true;
  measurement.samples_for_one = samples_for_one(result);
  measurement.tags_used = result.tags_verified;
  if (result.map_contradicted)
    measurement.map_px =
        expected_overlay_error_px(camera, pose.T_table_camera, result.map_covariance);
}

// How far apart two poses put the corners of the verified tags in the picture, in the mean [px].
double TableTracker::Impl::apart_px(const CameraPose& a, const CameraPose& b,
                                    std::span<const TagAlignment> seen) const {
  const auto from_a = a.inverse();
  const auto from_b = b.inverse();
  double sum = 0.0;
  double count = 0.0;
  for (const TagAlignment& tag : seen) {
    if (!tag.verified) continue;
    for (const Eigen::Vector3d& corner :
         table_tags[static_cast<std::size_t>(tag.index)].corners()) {
      const auto here = camera.project(from_a * corner);
      const auto there = camera.project(from_b * corner);
      if (!here || !there) continue;
      sum += (*here - *there).norm();
      count += 1.0;
    }
  }
  return count > 0.0 ? sum / count : 0.0;
}

// The pose from which the verified tags, all in the plane of the first of them, look the same but
// for perspective: what was farther from the camera than their middle is nearer by as much.
CameraPose TableTracker::Impl::mirrored(const CameraPose& pose,
                                        std::span<const TagAlignment> seen) const {
  const Transform<frame::Camera, frame::Table> T_camera_table = pose.inverse();
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();  // of the tags, in the table frame
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  int count = 0;
  for (const TagAlignment& tag : seen) {
    if (!tag.verified) continue;
    const auto& T_table_tag = table_tags[static_cast<std::size_t>(tag.index)].T_table_tag;
    if (count++ == 0) normal = T_table_tag.rotation() * Eigen::Vector3d::UnitZ();
    middle += T_table_tag.translation();
  }
  if (count > 0) middle /= count;
  const Eigen::Vector3d at = T_camera_table * middle;
  const Eigen::Vector3d sight = at.normalized();
  const auto reflection = [](const Eigen::Vector3d& n) {
    return Eigen::Matrix3d(Eigen::Matrix3d::Identity() - 2.0 * n * n.transpose());
  };
  const Eigen::Matrix3d R =
      reflection(sight) * T_camera_table.rotation_matrix() * reflection(normal);
  return Transform<frame::Camera, frame::Table>(Eigen::Quaterniond(R), at - R * middle).inverse();
}

// The other pose that a lone tag (or a few in one plane, seen from afar) allows, aligned as well:
// the picture itself is asked which of the two it is. True where it says the other. `of_first`:
// with what the best pose was aligned (its smear and velocity are those of both); `first_result`:
// of that pose.
bool TableTracker::Impl::add_second(const AlignmentInput& of_first, const ImageMotion& image_motion,
                                    const AlignmentResult& first_result, Measurement& measurement) {
  const std::vector<TagAlignment>& seen = first_result.tags;
  AlignmentInput input;
  input.luma = of_first.luma;
  input.exposure_motion = of_first.exposure_motion;
  input.velocity = of_first.velocity;
  input.predicted = mirrored(measurement.best.T_table_camera, seen);
  input.covariance = loose_covariance();
  input.left_out = left_out;
  measurement.second.reset();
  measurement.ambiguous = false;
  measurement.ambiguity_ratio = std::numeric_limits<double>::infinity();
  if (!input.predicted.is_finite()) return false;
  double residuals = kSameResiduals;
  for (const TagAlignment& tag : seen) {
    if (tag.verified && tag.cell_px > kRunTogether_sigmas * aligner.options().blur_px)
      residuals = 0.0;
  }
  const auto look_the_same = [&](const CameraPose& other, double residual_px) {
    return apart_px(measurement.best.T_table_camera, other, seen) <
           std::max(kSame_px, residuals * residual_px);
  };
  const CameraPose mirror = input.predicted;
  const AlignmentResult result = aligner.refine(input);
  const std::optional<RefinedPose> second = aligned(result, input.covariance, image_motion);
  if (!second) {
    // Cells that read right from one of two poses and wrong from the other are evidence, too, only
    // where the two look different.
    if (look_the_same(mirror, measurement.best.noise_px)) {
      measurement.second = measurement.best;
      measurement.second->T_table_camera = mirror;
      measurement.ambiguous = true;
      measurement.ambiguity_ratio = 1.0;
    }
    return false;
  }
  // Found again from the other side: the same pose, as far as it is known.
  constexpr double kSamePose_sigmas = 2.0;
  if (overlay_difference(camera, measurement.best.T_table_camera, second->T_table_camera).rms_px() <
      kSamePose_sigmas * expected_overlay_error_px(camera, measurement.best.T_table_camera,
                                                   measurement.best.covariance))
    return false;
  const double samples = static_cast<double>(result.counters.samples);
  double for_one = std::max(measurement.samples_for_one, samples_for_one(result));
  double first_residual = measurement.best.noise_px;
  if (second->noise_px < first_residual) {
    // The first had a prediction to please as well.
    input.predicted = measurement.best.T_table_camera;
    const std::optional<RefinedPose> first =
        aligned(aligner.refine(input), input.covariance, image_motion);
    if (first) {
      first_residual = std::min(first_residual, first->noise_px);
      for_one = std::max(for_one, samples_for_one(result));
    }
  }
  measurement.second = second;
  const double ratio = second->noise_px / std::max(first_residual, 1e-9);
  const bool is_other = ratio < 1.0;
  measurement.ambiguity_ratio = is_other ? 1.0 / std::max(ratio, 1e-9) : ratio;
  measurement.ambiguous =
      look_the_same(second->T_table_camera, std::min(first_residual, second->noise_px)) ||
      samples * std::log(measurement.ambiguity_ratio) < kDecides * for_one;
  if (is_other) std::swap(measurement.best, *measurement.second);
  return is_other;
}

// By the measured poses before it, as if the velocity changed evenly. A prediction is no part of
// it: it may not have been there, or not this one.
std::optional<CameraMotion> TableTracker::Impl::motion_at(std::int64_t timestamp_ns,
                                                          const CameraPose& pose) const {
  if (!measured) return std::nullopt;
  const double step_s = seconds(timestamp_ns - measured->timestamp_ns);
  if (!(step_s > 0.0 && step_s <= kPriorLifetime_s)) return std::nullopt;
  const Vector6d mean = perturbation_between(measured->pose, pose) / step_s;
  CameraMotion motion_there{mean, mean, true};
  if (before_measured) {
    const double before_s = seconds(measured->timestamp_ns - before_measured->timestamp_ns);
    if (before_s > 0.0 && before_s <= kPriorLifetime_s) {
      motion_there.change =
          mean - perturbation_between(before_measured->pose, measured->pose) / before_s;
      motion_there.velocity += step_s / (step_s + before_s) * motion_there.change;
      motion_there.of_one_step = false;
    }
  }
  if (!motion_there.velocity.allFinite() || !motion_there.change.allFinite()) return std::nullopt;
  return motion_there;
}

// With a rolling shutter the velocity is a part of the picture's geometry, with a known exposure of
// its blur. The one that was predicted is that of the frame before; where the one that the pose
// itself shows puts the first and the last row elsewhere, or smears the picture further, the frame
// is aligned once more.
void TableTracker::Impl::align_at_own_speed(const Frame& frame, AlignmentInput& input,
                                            AlignmentResult& result) {
  const double half_readout_s =
      0.5 * camera.parameters().rolling_shutter_row_s.value_or(0.0) * (camera.height() - 1);
  // The smear of a lone tag and its tilt look alike.
  const double exposure_s = result.tags_verified > 1 ? frame.exposure_s.value_or(0.0) : 0.0;
  if (!(half_readout_s > 0.0) && !(exposure_s > 0.0)) return;
  constexpr double kElsewhere_px = 0.1;
  constexpr double kSmeared_px = 2.0;
  // A motion that changes by more in a frame is not known to that; what it is taken for then does
  // more harm to a picture that is clear without (strong shake, its exposure told: 0.44 in place of
  // 0.48 px).
  constexpr double kEvenly = 0.25;
  constexpr int kTries = 2;
  for (int i = 0; i < kTries && result.verified; ++i) {
    const auto found = motion_at(frame.timestamp_ns, result.T_table_camera);
    if (!found) return;
    const Vector6d& velocity = found->velocity;
    const auto apart_px = [&](const Vector6d& xi) {
      return overlay_difference(camera, perturbed(result.T_table_camera, xi), result.T_table_camera)
          .rms_px();
    };
    const Vector6d smear = exposure_s * velocity;
    const bool elsewhere = half_readout_s > 0.0 &&
                           apart_px(half_readout_s * (velocity - input.velocity)) > kElsewhere_px;
    const bool smeared = exposure_s > 0.0 &&
                         apart_px(smear - input.exposure_motion) > kSmeared_px &&
                         apart_px(exposure_s * found->change) < kEvenly * apart_px(smear);
    if (!elsewhere && !smeared) return;
    const Vector6d velocity_before = std::exchange(input.velocity, velocity);
    const Vector6d smear_before = input.exposure_motion;
    if (smeared) input.exposure_motion = smear;
    // The picture decides whether it is smeared so.
    // ... and so it does where the pose before may be far off itself.
    const double residual = elsewhere && measured->tracked ? std::numeric_limits<double>::infinity()
                                                           : result.residual_rms;
    result = aligner.align(input);
    if (result.verified && result.residual_rms <= residual) continue;
    input.velocity = velocity_before;
    input.exposure_motion = smear_before;
    result = aligner.align(input);
    return;
  }
}

// A frame that is not clear is aligned once more with tags that are smeared along its motion: by
// the exposure, or where that is not known by as much of the frame as explains the picture best.
// Both poses are judged by what their smear hides.
void TableTracker::Impl::align_by_smear(const Frame& frame, AlignmentInput& input,
                                        AlignmentResult& result, SmearError& smear) {
  // The smear of a lone tag and its tilt look alike, and so may those of a few from afar.
  if (result.tags_verified < 2 || branch_open || smear.motion.isZero(0.0) ||
      !input.exposure_motion.isZero(0.0))
    return;
  const double residual = result.residual_rms;
  const int tags_before = result.tags_verified;
  input.exposure_motion = smear.motion;
  result = align_without(input, left_out, true);
  const bool enough = result.tags_verified >= 2 && 4 * result.tags_verified >= 3 * tags_before;
  // As shares of the gain: a model that is smeared as the picture is gives the contrast back, too.
  if (result.verified && enough && result.residual_rms <= residual && result.contradicting < 0 &&
      !is_doubtful(result, true)) {
    const SmearError left = motion_found(frame, result, kAligned_cells).smear;
    // A pose from which nothing moved by a cell may have slid along a smear that is still there.
    const bool slid = left.shift_px == 0.0 && aligner.smear_error(kAligned_cells).shift_px > 0.0;
    if (left.shift_px < smear.shift_px && !slid) {
      smear = left;
      note_work(result);
      return;
    }
  }
  input.exposure_motion.setZero();
  result = align_without(input, left_out, true);
}

// What a measured pose says of the motion in its frame, and that of what it did to the picture.
// `longest_smear_cells`: that the method which found it reads.
ImageMotion TableTracker::Impl::motion_found(const Frame& frame, const AlignmentResult& result,
                                             double longest_smear_cells) {
  ImageMotion found = kUnknownMotion;
  if (!result.verified) return found;
  const auto motion_there = motion_at(frame.timestamp_ns, result.T_table_camera);
  if (!motion_there) {
    found.smear = aligner.smear_error(longest_smear_cells);
    return found;
  }
  constexpr double kFrame_s = 1.0 / 30.0;
  const auto moves_px = [&](const Vector6d& velocity) {
    return overlay_difference(camera, perturbed(result.T_table_camera, kFrame_s * velocity),
                              result.T_table_camera)
        .rms_px();
  };
  // Of frames that lie further apart nothing says whether those between them were not seen, or they
  // were exposed for longer, in the dark: the first.
  constexpr double kLongestExposure_s = 1.0 / 30.0;
  const double exposure_s = std::min(
      frame.exposure_s.value_or(std::min(frame_interval_s, kLongestExposure_s)), frame_interval_s);
  // A motion of one step alone is that between two poses of which either may be displaced by a
  // smear: with a third before them they would have to be displaced alike.
  if (exposure_s > 0.0)
    found.smear =
        aligner.smear_error(exposure_s * motion_there->velocity, frame.exposure_s.has_value(),
                            motion_there->of_one_step ? longest_smear_cells : 0.0);
  // What jumped between two clear pictures did not move so within them.
  if (!(found.smear.shift_px > 0.0)) return found;
  found.predicted = std::max(found.predicted, moves_px(motion_there->velocity));
  found.missed = std::max(found.missed, moves_px(motion_there->change));
  return found;
}

void TableTracker::Impl::note_work(const AlignmentResult& result) {
  times.samples = last_samples = result.counters.samples;
  times.tags_out_of_view = result.counters.tags_out_of_view;
  times.tags_too_small = result.counters.tags_too_small;
  times.sampling_stopped = result.counters.sampling_stopped;
  times.near_start = !result.counters.wide_stage;
  times.fewer_pixels = options.mode == TrackingMode::automatic && !times.every_pixel &&
                       !(options.pose_budget_px > 0.0);  // that takes them as it needs them
}

// Whether tags that are not left out are enough to tell that one more of them is wrong: a bare
// majority may be the half that was moved, with one or two of the others fitting it.
bool TableTracker::Impl::may_leave_out(const AlignmentResult& result) const {
  return 3 * (left_out.size() + 1) <=
         left_out.size() + static_cast<std::size_t>(result.counters.tags_visible);
}

// Whether the tags that fit say no more than those that don't. Two or three may fit each other by
// chance: not where more than a third of what is seen clearly lies elsewhere; nor, for some frames
// after tags that contradicted each other, where they are not most of those in the picture or don't
// agree. (For some frames only: the others may be covered, or not there.)
bool TableTracker::Impl::is_doubtful(const AlignmentResult& result, bool with_search) const {
  if (!result.verified) return false;
  int elsewhere = 0;
  for (const TagAlignment& tag : result.tags) {
    if (tag.verified) continue;
    const bool detected =
        !with_search &&
        std::ranges::find(observations, tag.index, &TagObservation::id) != observations.end();
    elsewhere += tag.displaced || detected ? 1 : 0;
  }
  if (result.tags_verified < 2 * elsewhere) return true;
  constexpr double kDoubtful_px = 0.15;  // where one tag may have bent the others' pose
  return frames_doubtful > 0 && !with_search &&
         (3 * result.tags_verified < 2 * result.counters.tags_in_picture ||
          (result.disagreement >= kDisagree && result.displaced_px >= kDoubtful_px));
}

AlignmentResult TableTracker::Impl::align_without(AlignmentInput& input,
                                                  std::span<const int> without, bool with_search) {
  input.left_out = without;
  return with_search ? aligner.align(input) : aligner.refine(input);
}

// The tag without which all others agree, tried one after the other from where their own corners
// put the camera: a pose may have been made to fit the wrong one, and the equations there know of
// no better one.
void TableTracker::Impl::leave_one_out(AlignmentInput& input, AlignmentResult& result) {
  constexpr std::size_t kMostToTry = 6;
  constexpr double kAgree = 3.0;
  if (result.counters.tags_visible < 4 || !may_leave_out(result)) return;
  std::vector<TagAlignment> candidates = result.tags;
  std::ranges::stable_sort(candidates, {}, &TagAlignment::weight_share);
  candidates.resize(std::min(candidates.size(), kMostToTry));
  double least = kAgree;
  int culprit = -1;
  const CameraPose with_all = input.predicted;
  CameraPose best_start = with_all;
  for (const TagAlignment& candidate : candidates) {
    std::vector<int> without = left_out;
    without.push_back(candidate.index);
    std::vector<TagObservation> others;
    for (const TagObservation& seen : observations) {
      if (std::ranges::find(without, seen.id) == without.end()) others.push_back(seen);
    }
    const Result<BoardPose> start = estimate_board_pose(camera, others);
    if (!start || start->contradictory || !start->best.T_table_camera.is_finite()) continue;
    input.predicted = start->best.T_table_camera;
    const AlignmentResult rest = align_without(input, without, false);
    if (!rest.verified || rest.tags_verified < rest.counters.tags_in_picture ||
        !(rest.disagreement < least))
      continue;
    least = rest.disagreement;
    culprit = candidate.index;
    best_start = input.predicted;
  }
  input.predicted = best_start;
  if (culprit >= 0) {
    left_out.push_back(culprit);
    frames_without = 0;
  }
  result = align_without(input, left_out, false);
}

// How far each tag would be elsewhere if it were alone [px], RMS over those that can be.
double TableTracker::Impl::scatter_px(const AlignmentResult& joint, const AlignmentInput& input) {
  const CameraPose& pose = joint.T_table_camera;
  AlignmentInput alone = input;
  alone.predicted = pose;
  alone.covariance = loose_covariance();
  double sum = 0.0;
  double count = 0.0;
  for (const TagAlignment& tag : joint.tags) {
    std::vector<int> others;
    for (int i = 0; i < static_cast<int>(table_tags.size()); ++i) {
      if (i != tag.index) others.push_back(i);
    }
    const AlignmentResult own = align_without(alone, others, false);
    if (!own.verified || !own.T_table_camera.is_finite()) continue;
    const auto centre = table_tags[static_cast<std::size_t>(tag.index)].T_table_tag.translation();
    const auto here = camera.project(pose.inverse() * centre);
    const auto there = camera.project(own.T_table_camera.inverse() * centre);
    if (!here || !there) continue;
    sum += (*here - *there).squaredNorm();
    count += 1.0;
  }
  return count > 0.0 ? std::sqrt(sum / count) : 0.0;
}

// Leaves out tags that contradict the others and aligns again. False where nothing says which are
// right: too many would have to go, or the tags lie elsewhere with no single one to blame.
bool TableTracker::Impl::settle(AlignmentInput& input, AlignmentResult& result, bool with_search) {
  while (result.verified && result.contradicting >= 0) {
    if (!may_leave_out(result)) return false;
    left_out.push_back(result.contradicting);
    frames_without = 0;
    result = align_without(input, left_out, with_search);
  }
  const bool doubtful = is_doubtful(result, with_search);
  if (!result.verified || (result.disagreement < kDisagree && !doubtful)) return true;
  if (!with_search) leave_one_out(input, result);
  if (doubtful && is_doubtful(result, with_search)) return false;
  // What fits here and there only.
  if (result.verified && result.disagreement >= kDisagree &&
      3 * result.tags_verified < 2 * result.counters.tags_visible)
    return false;
  // Less than the first is what lens, tone curve and paper do to real tags, as far as the pixels
  // that fit the pose tell; less than the second when each tag is free to go [px].
  constexpr double kSuspicious_px = 0.3;
  constexpr double kElsewhere_px = 0.5;
  if (!result.verified || result.disagreement < kDisagree || result.displaced_px < kSuspicious_px)
    return true;
  constexpr int kSeldom = 15;  // [frames]
  if (with_search && frames_unasked++ % kSeldom != 0) return true;
  const double apart_px = scatter_px(result, input);
  result = align_without(input, left_out, with_search);
  return apart_px < kElsewhere_px;
}

// A tag that is left out counts again when the others agree with it: it may have been put back, and
// corners alone may have blamed the wrong one.
void TableTracker::Impl::look_again(AlignmentInput& input, AlignmentResult& result,
                                    bool with_search) {
  if (left_out.empty() || !result.verified) return;
  frames_without = 0;
  const double without_it = result.disagreement;
  for (std::size_t i = 0; i < left_out.size(); ++i) {
    std::vector<int> fewer = left_out;
    const int tag = fewer[i];
    fewer.erase(fewer.begin() + static_cast<std::ptrdiff_t>(i));
    const AlignmentResult all = align_without(input, fewer, with_search);
    const auto it = std::ranges::find(all.tags, tag, &TagAlignment::index);
    const bool agrees = all.verified && it != all.tags.end() && it->verified &&
                        all.disagreement < std::max(kDisagree / 2.0, 1.5 * without_it);
    if (!agrees) continue;
    left_out = fewer;
    break;
  }
  result = align_without(input, left_out, with_search);
}

// The frame by alignment from where the last ones say the camera is; nothing when that does not
// verify. From a hint the state of the motion only says where to look.
std::optional<PoseEstimate> TableTracker::Impl::follow(const Frame& frame, ImageView image,
                                                       Start start) {
  const bool from_hint = start != Start::own_motion;
  if (!motion.has_state()) return std::nullopt;
  const MotionPrediction prediction = motion.predict(frame.timestamp_ns);
  if (!prediction.T_table_camera.is_finite() || !prediction.covariance.allFinite()) {
    motion.reset();
    return std::nullopt;
  }
  const double motion_px = image_motion_px(prediction);
  choose_effort(motion_px);
  const Stopwatch align;
  AlignmentInput input;
  input.luma = image;
  input.predicted = prediction.T_table_camera;
  input.covariance = prediction.covariance;
  input.first_samples = last_samples;
  input.starts_far = last_start_far;
  input.seen_contrast = last_contrast;
  input.velocity = prediction.velocity;
  input.left_out = left_out;
  AlignmentResult result = aligner.align(input);
  if (result.verified && !from_hint) align_at_own_speed(frame, input, result);
  if (!settle(input, result, true)) {
    align.add_to(times.align_ms, times.align_cpu_ms);
    contradicted = true;
    return std::nullopt;
  }
  constexpr int kSeldom = 60;  // [frames]
  if (!left_out.empty() && ++frames_without >= kSeldom) look_again(input, result, true);
  note_work(result);
  last_start_far = result.counters.far_start;
  last_contrast = result.verified ? result.counters.contrast : 0.0;
  ImageMotion image_motion{motion_px, 0.0, {}};
  // Nobody saw these tags where they are looked for: a part of them may be there by a mistake of
  // the map that a search would find.
  if (start == Start::hint && 3 * result.tags_verified < 2 * result.counters.tags_visible) {
    align.add_to(times.align_ms, times.align_cpu_ms);
    return std::nullopt;
  }
  if (from_hint && result.verified) {
    input.predicted = result.T_table_camera;
    input.covariance = loose_covariance();
    result = aligner.refine(input);
    note_work(result);
    image_motion = motion_found(frame, result, kAligned_cells);
  } else if (result.verified) {
    image_motion.smear = motion_found(frame, result, kAligned_cells).smear;
    align_by_smear(frame, input, result, image_motion.smear);
    image_motion.missed =
        overlay_difference(camera, result.T_table_camera, prediction.T_table_camera).rms_px();
  }
  const std::optional<RefinedPose> best = aligned(result, input.covariance, image_motion);
  if (!best) {
    align.add_to(times.align_ms, times.align_cpu_ms);
    return std::nullopt;
  }
  const Matrix6d filter_covariance = result.covariance;
  Measurement measurement;
  take(*best, result, measurement);
  measurement.left_out = left_out;
  last_tags = result.tags_verified;
  bool other = false;  // whether the picture says that it is not the pose that is followed
  if (result.tags_verified == 1 || branch_open) {
    other = add_second(input, image_motion, result, measurement);
  }
  align.add_to(times.align_ms, times.align_cpu_ms);
  std::optional<CameraPose> expected = prediction.T_table_camera;
  if (branch_open || from_hint) {
    expected.reset();
  } else if (other && !measurement.ambiguous) {
    // Against what was followed so far one picture is not enough: the next one decides.
    std::swap(measurement.best, *measurement.second);
    measurement.ambiguous = true;
    expected.reset();
  }
  PoseEstimate estimate = judge(measurement, expected);
  branch_open = estimate.status == TrackStatus::uncertain && measurement.ambiguous &&
                estimate.reason == kTwoPoses;
  if (!from_hint && estimate.T_table_camera.matrix() == best->T_table_camera.matrix()) {
    motion.update(frame.timestamp_ns, best->T_table_camera, filter_covariance);
  } else {
    motion.start(frame.timestamp_ns, estimate.T_table_camera, estimate.covariance);
  }
  return estimate;
}

// The same from a pose that somebody else believes in. It may be off by what the pattern's own
// search finds; of the pose found it says nothing.
std::optional<PoseEstimate> TableTracker::Impl::follow_hint(const Frame& frame, ImageView image,
                                                            const CameraPose& hint, Start start) {
  if (!hint.is_finite()) return std::nullopt;
  constexpr double kHintLinear_m = 0.01;
  constexpr double kHintAngular_rad = 0.03;
  Matrix6d covariance = Matrix6d::Zero();
  covariance.diagonal().head<3>().setConstant(kHintLinear_m * kHintLinear_m);
  covariance.diagonal().tail<3>().setConstant(kHintAngular_rad * kHintAngular_rad);
  const Following before = *this;
  branch_open = false;
  motion.start(frame.timestamp_ns, hint, covariance);
  std::optional<PoseEstimate> found = follow(frame, image, start);
  if (!found) static_cast<Following&>(*this) = before;
  return found;
}

// The same where the camera went much further than the pattern's own search looks.
std::optional<PoseEstimate> TableTracker::Impl::follow_far(const Frame& frame, ImageView image) {
  if (!motion.has_state()) return std::nullopt;
  const MotionPrediction prediction = motion.predict(frame.timestamp_ns);
  AlignmentInput input;
  input.luma = image;
  input.predicted = prediction.T_table_camera;
  input.covariance = loose_covariance();
  input.velocity = prediction.velocity;
  for (const bool further : {false, true}) {
    const Stopwatch align;
    input.left_out = left_out;
    const std::optional<CameraPose> guess = aligner.search_coarsely(input, further);
    align.add_to(times.align_ms, times.align_cpu_ms);
    if (!guess) continue;
    const MotionModel before = motion;
    const std::optional<PoseEstimate> found = follow_hint(frame, image, *guess, Start::hint);
    if (!found) {
      contradicted = false;  // it was before this guess, which may be all wrong
      continue;
    }
    times.coarse_search = true;
    if (!branch_open) {
      motion = before;  // two poses give a velocity
      motion.update(frame.timestamp_ns, found->T_table_camera, found->covariance);
    }
    return found;
  }
  return std::nullopt;
}

// Whether so few of the tags that should be readable are missing that a finer search would find no
// other pose, nor a contradiction.
bool TableTracker::Impl::shows_most(const Measurement& measurement) const {
  return !measurement.contradictory && !measurement.ambiguous && measurement.tags_used > 1 &&
         3 * measurement.tags_used >= 2 * tags_in_view(measurement.best.T_table_camera);
}

// Where the table's tags would be, with as much room about them as a hand moves in some frames;
// nothing where that is most of the picture.
std::optional<PixelBox> TableTracker::Impl::box_about(const CameraPose& pose) const {
  constexpr double kLeastRoom_px = 32.0;
  constexpr double kMostOfPicture = 0.6;
  const auto T_camera_table = pose.inverse();
  Eigen::AlignedBox2d box;
  for (const MappedTag& tag : table_tags) {
    for (const Eigen::Vector3d& corner : tag.corners()) {
      const std::optional<Eigen::Vector2d> pixel = camera.project(T_camera_table * corner);
      if (pixel && pixel->allFinite()) box.extend(*pixel);
    }
  }
  const Eigen::AlignedBox2d picture(Eigen::Vector2d::Zero(),
                                    Eigen::Vector2d(camera.width(), camera.height()));
  if (box.isEmpty()) return std::nullopt;
  const double room = std::max(kLeastRoom_px, 0.25 * box.sizes().maxCoeff());
  box.min().array() -= room;
  box.max().array() += room;
  box = box.intersection(picture);
  if (box.isEmpty() || box.volume() > kMostOfPicture * picture.volume()) return std::nullopt;
  const auto x = static_cast<int>(box.min().x());
  const auto y = static_cast<int>(box.min().y());
  const PixelBox pixels{x, y, static_cast<int>(box.max().x()) - x,
                        static_cast<int>(box.max().y()) - y};
  if (pixels.width < 1 || pixels.height < 1) return std::nullopt;
  return pixels;
}

// The frame is searched coarsely and at the full resolution in turn: what is lost for long costs no
// more than detecting does. The first one may be the only one, and is searched in every way.
// Coarsely is at a quarter of the resolution, which costs a quarter of what half of it does, and at
// half of it where that shows too little.
Result<Measurement> TableTracker::Impl::measure_by_search(
    SearchResolution finest, const std::optional<CameraPose>& predicted) {
  const auto box =
      predicted && finest != SearchResolution::quarter ? box_about(*predicted) : std::nullopt;
  if (box && !search->searched(SearchResolution::half)) {
    const Stopwatch detect;
    const std::vector<TagDetection> tags_there = search->tags_within(*box);
    detect.add_to(times.detect_ms, times.detect_cpu_ms);
    Result<Measurement> there = measure(tags_there);
    times.box_detection = there && shows_most(*there);
    if (times.box_detection) return there;
  }
  const bool first = !std::exchange(searched_before, true) && finest == SearchResolution::full;
  if (finest == SearchResolution::full && std::exchange(full_next, !full_next)) {
    return measure_by_detection(SearchResolution::full);
  }
  Result<Measurement> quick = measure_by_detection(SearchResolution::quarter);
  if (quick && shows_most(*quick)) return quick;
  if (finest == SearchResolution::quarter) {
    if (!quick) return quick;
    return fail("few of the tags are seen yet");
  }
  Result<Measurement> half = measure_by_detection(SearchResolution::half);
  const bool enough = half && !half->contradictory &&
                      3 * half->tags_used >= 2 * tags_in_view(half->best.T_table_camera);
  if (!first || enough) return half;
  Result<Measurement> full = measure_by_detection(SearchResolution::full);
  return full ? full : half;
}

// The frame by detection, refined by alignment where that verifies.
PoseEstimate TableTracker::Impl::find(const Frame& frame, ImageView image,
                                      const std::optional<CameraPose>& predicted,
                                      SearchResolution finest) {
  constexpr int kDoubtfulFrames = 5;
  Result<Measurement> measurement = measure_by_search(finest, predicted);
  if (!measurement) return without_measurement(frame.timestamp_ns, measurement.error().message);
  if (measurement->contradictory) {
    frames_doubtful = kDoubtfulFrames;
  } else {
    const Stopwatch align;
    // How fast the view moves is not known yet: as if it did.
    times.every_pixel = options.mode == TrackingMode::accurate ||
                        (options.mode == TrackingMode::automatic &&
                         (measurement->tags_used < kFewTags || options.pose_budget_px > 0.0));
    aligner.set_effort(times.every_pixel ? AlignmentEffort::accurate : AlignmentEffort::fast);
    AlignmentInput input;
    input.luma = image;
    input.predicted = measurement->best.T_table_camera;
    input.covariance = loose_covariance();
    left_out = measurement->left_out;
    frames_without = 0;
    input.left_out = left_out;
    // How fast the camera goes is not known here.
    AlignmentResult result = aligner.refine(input);
    if (!left_out.empty()) look_again(input, result, false);
    measurement->contradictory = !settle(input, result, false);
    measurement->left_out = left_out;
    note_work(result);
    const ImageMotion image_motion = motion_found(frame, result, kDetected_cells);
    const std::optional<RefinedPose> best = aligned(result, input.covariance, image_motion);
    if (best) {
      take(*best, result, *measurement);
      last_tags = result.tags_verified;
      // Until the velocity is known the view rests as far as anybody knows, and every pixel is
      // used; the rounds that bring them near need not be of all. But for few tags, whose tilt
      // hangs on single edges.
      last_start_far = options.mode == TrackingMode::automatic && last_tags >= kFewTags &&
                       result.counters.far_start;
      // Few or small tags that face the camera may turn either way, though their corners know one.
      constexpr double kUnsure_px = 0.5;
      if (measurement->ambiguous || last_tags == 1 ||
          expected_overlay_error_px(camera, best->T_table_camera, best->covariance) > kUnsure_px) {
        add_second(input, image_motion, result, *measurement);
      } else {
        measurement->second.reset();
      }
    }
    frames_doubtful = measurement->contradictory ? std::max(frames_doubtful - 1, 0) : 0;
    align.add_to(times.align_ms, times.align_cpu_ms);
  }
  solve_by_ceres(*measurement);
  times.corner_solve_skipped = !measurement->by_ceres;
  const PoseEstimate estimate = judge(*measurement, predicted);
  contradicted = measurement->contradictory;
  if (measurement->contradictory) {
    motion.reset();
    return estimate;
  }
  const bool was_open = std::exchange(branch_open, estimate.reason == kTwoPoses);
  if (motion.has_state() && !was_open && !branch_open) {
    // Two poses give a velocity.
    motion.update(frame.timestamp_ns, estimate.T_table_camera, estimate.covariance);
  } else {
    motion.start(frame.timestamp_ns, estimate.T_table_camera, estimate.covariance);
  }
  if (estimate.status == TrackStatus::tracked) full_next = false;
  return estimate;
}

TableTracker::TableTracker(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TableTracker::TableTracker(TableTracker&&) noexcept = default;
TableTracker& TableTracker::operator=(TableTracker&&) noexcept = default;
TableTracker::~TableTracker() = default;

Result<TableTracker> TableTracker::create(const CameraModel& camera, const TagMap& tags,
                                          const TrackerOptions& options) {
  std::vector<TagFamily> families;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group == kTableGroup) families.push_back(tag.family);
  }
  if (families.empty()) {
    return fail(
        "tag map: no tag belongs to the group 'table', so nothing says where the table is; leave "
        "out `group` for the tags that are fixed to it");
  }
  PENUMBRA_TRY(TagSearch search,
               TagSearch::create(families, options.detector, camera.parameters().tone_curve));
  return create(camera, tags, options, std::make_shared<TagSearch>(std::move(search)));
}

Result<TableTracker> TableTracker::create(const CameraModel& camera, const TagMap& tags,
                                          const TrackerOptions& options,
                                          std::shared_ptr<TagSearch> search) {
  PENUMBRA_ASSERT(search != nullptr);
  const auto positive = [](double value) { return std::isfinite(value) && value > 0.0; };
  if (!positive(options.tracked_overlay_px) || !positive(options.ambiguity_ratio) ||
      !positive(options.max_reprojection_rms_px) || !(options.hold_s >= 0.0) ||
      !std::isfinite(options.pose_budget_px) || options.pose_budget_px < 0.0)
    return fail("tracker options: every limit must be a positive number");
  std::vector<MappedTag> table_tags;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group == kTableGroup) table_tags.push_back(tag);
  }
  PENUMBRA_TRY(TagAligner aligner, TagAligner::create(camera, table_tags));
  return TableTracker(std::make_unique<Impl>(camera, tags, options, std::move(search),
                                             std::move(aligner), std::move(table_tags)));
}

TrackedFrame TableTracker::track(const Frame& frame) {
  const Stopwatch total;
  impl_->search->begin(frame);
  TrackedFrame result = track(frame, SharedFrame());
  total.add_to(result.times.total_ms, result.times.total_cpu_ms);
  return result;
}

TrackedFrame TableTracker::track(const Frame& frame, const SharedFrame& shared) {
  impl_->times = {};
  TrackedFrame result;
  result.frame = frame;
  result.pose = impl_->estimate(frame, shared);
  result.times = impl_->times;
  return result;
}

PoseEstimate TableTracker::locate(std::span<const TagDetection> detections) {
  Result<Measurement> measurement = impl_->measure(detections);
  if (!measurement) {
    PoseEstimate lost;
    lost.reason = measurement.error().message;
    return lost;
  }
  impl_->solve_by_ceres(*measurement);
  impl_->contradicted = measurement->contradictory;
  return impl_->judge(*measurement, std::nullopt);
}

}  // namespace penumbra
