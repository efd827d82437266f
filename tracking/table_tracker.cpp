#include "tracking/table_tracker.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "core/evaluation.hpp"
#include "core/stopwatch.hpp"
#include "core/units.hpp"
#include "tracking/board_pose.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kTableGroup = "table";
// How long a measured pose still says where the camera is now, well enough to choose between two
// poses or to give a velocity.
constexpr double kPriorLifetime_s = 0.2;

// What one frame says about the pose, whatever method found it.
struct Measurement {
  RefinedPose best;
  std::optional<RefinedPose> second;
  double ambiguity_ratio = std::numeric_limits<double>::infinity();
  int tags_used = 0;
  bool ambiguous = false;  // the second pose may be the true one
  bool contradictory = false;
};

struct TimedPose {
  std::int64_t timestamp_ns = 0;
  CameraPose pose;
  Matrix6d covariance = Matrix6d::Zero();
};

std::array<std::uint8_t, 256> linearising_table(double exponent) {
  std::array<std::uint8_t, 256> table{};
  for (std::size_t i = 0; i < table.size(); ++i) {
    table[i] = static_cast<std::uint8_t>(
        std::lround(255.0 * std::pow(static_cast<double>(i) / 255.0, exponent)));
  }
  return table;
}

}  // namespace

struct TableTracker::Impl {
  CameraModel camera;
  TagMap tags;
  TrackerOptions options;
  TagDetector detector;
  std::optional<std::array<std::uint8_t, 256>> linearise;

  std::vector<std::uint8_t> luma_scratch;
  std::vector<std::uint8_t> linear_scratch;

  // The last two tracked poses, newest first.
  std::optional<TimedPose> last;
  std::optional<TimedPose> before_last;
  TrackStatus last_status = TrackStatus::tracked;  // of the last measured pose

  TrackTimes times;

  [[nodiscard]] ImageView tracking_image(const Frame& frame);
  [[nodiscard]] std::optional<CameraPose> predict(std::int64_t timestamp_ns) const;
  [[nodiscard]] Result<Measurement> measure_by_detection(ImageView image);
  [[nodiscard]] int tags_in_view(const CameraPose& pose) const;
  [[nodiscard]] PoseEstimate judge(const Measurement& measurement,
                                   const std::optional<CameraPose>& predicted) const;
  [[nodiscard]] PoseEstimate without_measurement(std::int64_t timestamp_ns,
                                                 std::string reason) const;
  [[nodiscard]] PoseEstimate estimate(const Frame& frame);
};

// The luma where it lies; linear in light where the camera's tone curve is known, because a tone
// curve makes white bleed into black and moves every edge into the tag.
ImageView TableTracker::Impl::tracking_image(const Frame& frame) {
  const ImageView image = luma(frame, luma_scratch);
  if (!linearise) return image;
  const auto width = static_cast<std::size_t>(image.width);
  linear_scratch.resize(width * static_cast<std::size_t>(image.height));
  for (int y = 0; y < image.height; ++y) {
    const std::uint8_t* in = image.row(y);
    std::uint8_t* out = linear_scratch.data() + static_cast<std::size_t>(y) * width;
    for (std::size_t x = 0; x < width; ++x) out[x] = (*linearise)[in[x]];
  }
  return {linear_scratch.data(), image.width, image.height, image.width};
}

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

Result<Measurement> TableTracker::Impl::measure_by_detection(ImageView image) {
  const Stopwatch detect;
  const std::vector<TagDetection> detections = detector.detect(image);
  detect.add_to(times.detect_ms, times.detect_cpu_ms);
  times.full_detection = true;

  const Stopwatch solve;
  std::vector<TagObservation> observations;
  bool seen_twice = false;
  for (std::size_t i = 0; i < detections.size(); ++i) {
    const TagDetection& detection = detections[i];
    const MappedTag* tag = tags.find(detection.family, detection.id);
    // Another group is rigid in itself but may stand elsewhere on the table by now.
    if (tag == nullptr || tag->group != kTableGroup) continue;
    const auto same = [&](const TagDetection& other) {
      return other.family == detection.family && other.id == detection.id;
    };
    if (std::count_if(detections.begin(), detections.end(), same) > 1) {
      seen_twice = true;  // nothing says which of them lies where the map has it
      continue;
    }
    observations.push_back({tag->id, tag->corners(), detection.corners_px});
  }
  const Result<BoardPose> board = estimate_board_pose(camera, observations);
  solve.add_to(times.solve_ms, times.solve_cpu_ms);
  if (!board) {
    if (observations.empty() && seen_twice) return fail("the same tag is in view twice");
    return tl::unexpected(board.error());
  }
  Measurement measurement;
  measurement.best = board->best;
  measurement.second = board->second;
  measurement.ambiguity_ratio = board->ambiguity_ratio();
  measurement.tags_used = board->tags_used;
  measurement.ambiguous = board->is_ambiguous(options.ambiguity_ratio);
  measurement.contradictory = board->contradictory;
  if (measurement.best.rms_px > options.max_reprojection_rms_px)
    return fail("the tags do not fit the map ({:.1f} px)", measurement.best.rms_px);
  return measurement;
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
                                       const std::optional<CameraPose>& predicted) const {
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
  const double share = static_cast<double>(std::max(tags_in_view(chosen.T_table_camera), 1)) /
                       static_cast<double>(std::max(measurement.tags_used, 1));
  estimate.covariance = chosen.covariance * std::max(share, 1.0);
  estimate.reprojection_rms_px = chosen.rms_px;
  estimate.ambiguity_ratio = measurement.ambiguity_ratio;
  estimate.tags_used = measurement.tags_used;
  estimate.expected_overlay_error_px = std::hypot(
      expected_overlay_error_px(camera, chosen.T_table_camera, estimate.covariance), between_px);
  estimate.status = TrackStatus::uncertain;
  if (measurement.contradictory) {
    estimate.reason = "the tags contradict each other";
  } else if (open) {
    estimate.reason = "two poses fit";
  } else if (!(estimate.expected_overlay_error_px < options.tracked_overlay_px)) {
    estimate.reason =
        std::isfinite(estimate.expected_overlay_error_px)
            ? fmt::format("expected error {:.1f} px", estimate.expected_overlay_error_px)
            : "the table's centre is out of sight";
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
  // A hand changes its speed: by about 2 m/s^2 and 10 rad/s^2 [1 sigma].
  const double travel = 0.5 * 2.0 * age_s * age_s;
  const double turn = 0.5 * 10.0 * age_s * age_s;
  estimate.covariance = last->covariance;
  estimate.covariance.diagonal().head<3>().array() += travel * travel;
  estimate.covariance.diagonal().tail<3>().array() += turn * turn;
  estimate.expected_overlay_error_px =
      expected_overlay_error_px(camera, estimate.T_table_camera, estimate.covariance);
  return estimate;
}

PoseEstimate TableTracker::Impl::estimate(const Frame& frame) {
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
  const ImageView image = tracking_image(frame);
  const bool recent = last && seconds(frame.timestamp_ns - last->timestamp_ns) <= kPriorLifetime_s;
  const std::optional<CameraPose> predicted = recent ? predict(frame.timestamp_ns) : std::nullopt;

  // A frame-to-frame measurement from `predicted` belongs here, before the detection.
  const Result<Measurement> measurement = measure_by_detection(image);
  if (!measurement) return without_measurement(frame.timestamp_ns, measurement.error().message);
  PoseEstimate estimate = judge(*measurement, predicted);
  last_status = estimate.status;
  if (estimate.status == TrackStatus::tracked) {
    before_last = std::exchange(
        last, TimedPose{frame.timestamp_ns, estimate.T_table_camera, estimate.covariance});
  }
  return estimate;
}

TableTracker::TableTracker(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TableTracker::TableTracker(TableTracker&&) noexcept = default;
TableTracker& TableTracker::operator=(TableTracker&&) noexcept = default;
TableTracker::~TableTracker() = default;

Result<TableTracker> TableTracker::create(const CameraModel& camera, const TagMap& tags,
                                          const TrackerOptions& options) {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0.0; };
  if (!positive(options.tracked_overlay_px) || !positive(options.ambiguity_ratio) ||
      !positive(options.max_reprojection_rms_px) || !(options.hold_s >= 0.0))
    return fail("tracker options: every limit must be a positive number");
  std::vector<TagFamily> families;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group == kTableGroup) families.push_back(tag.family);
  }
  if (families.empty()) {
    return fail(
        "tag map: no tag belongs to the group 'table', so nothing says where the table is; leave "
        "out `group` for the tags that are fixed to it");
  }
  Result<TagDetector> detector = TagDetector::create(families, options.detector);
  if (!detector) return tl::unexpected(detector.error());
  auto impl = std::make_unique<Impl>(Impl{
      camera, tags, options, std::move(*detector), {}, {}, {}, {}, {}, TrackStatus::tracked, {}});
  if (camera.parameters().tone_curve)
    impl->linearise = linearising_table(*camera.parameters().tone_curve);
  return TableTracker(std::move(impl));
}

TrackedFrame TableTracker::track(const Frame& frame) {
  const Stopwatch total;
  impl_->times = {};
  TrackedFrame result;
  result.frame = frame;
  result.pose = impl_->estimate(frame);
  result.times = impl_->times;
  total.add_to(result.times.total_ms, result.times.total_cpu_ms);
  return result;
}

}  // namespace penumbra
