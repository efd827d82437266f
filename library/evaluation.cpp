#include "core/evaluation/evaluation.hpp"

#include <cmath>
#include <penumbra/evaluation.hpp>
#include <tuple>

#include "core/evaluation/pose_convention_hint.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "library/support.hpp"

namespace penumbra::evaluation {
namespace {

constexpr double kMaxSeconds = 1e9;

penumbra::Trajectory checked(const Trajectory& given, std::string_view name) {
  if (given.empty()) throw_failure("{}: holds no pose", name);
  penumbra::Trajectory trajectory;
  for (std::size_t i = 0; i < given.size(); ++i) {
    const StampedPose& pose = given[i];
    const std::int64_t time = pose.timestamp_ns;
    if (time > kMaxTime_ns || time < -kMaxTime_ns) {
      throw_failure("{}[{}]: its time of {} ns is out of range; give nanoseconds up to 2^61", name,
                    i, time);
    }
    if (i > 0 && time <= given[i - 1].timestamp_ns) {
      throw_failure(
          "{}[{}]: its time of {} ns is not after {} ns; give the poses in the order of time", name,
          i, time, given[i - 1].timestamp_ns);
    }
    if (pose.predicted_px && !(*pose.predicted_px >= 0.0 && std::isfinite(*pose.predicted_px))) {
      throw_failure("{}[{}]: predicted_px: is {}; give pixels, or nothing", name, i,
                    *pose.predicted_px);
    }
    const auto T_table_camera = checked_transform<frame::Table, frame::Camera>(
        pose.T_table_camera, fmt::format("{}[{}]: T_table_camera", name, i));
    trajectory.poses.push_back({time, T_table_camera, {}, pose.predicted_px});
  }
  return trajectory;
}

std::int64_t checked_ns(double time_s, double min_s, std::string_view name) {
  if (!(time_s >= min_s && time_s <= kMaxSeconds)) {
    throw_failure("{}: is {}; give seconds from {:g} to {:g}", name, time_s, min_s, kMaxSeconds);
  }
  return nanoseconds(time_s);
}

Statistics to_public(const penumbra::Statistics& statistics) {
  return {statistics.rmse, statistics.median, statistics.p95, statistics.max};
}

}  // namespace

Trajectory load_trajectory(const std::filesystem::path& file) {
  return guarded([&] {
    Trajectory loaded;
    for (const penumbra::StampedPose& pose :
         value_or_throw(penumbra::load_trajectory(file)).poses) {
      loaded.push_back(
          {pose.timestamp_ns, penumbra::to_public(pose.T_table_camera), pose.predicted_px});
    }
    return loaded;
  });
}

void save_trajectory(const std::filesystem::path& file, const Trajectory& trajectory) {
  guarded([&] {
    std::ignore = checked(trajectory, "trajectory");
    // Not by format_tum(), whose transform would normalise the quaternions again.
    std::string text = "# timestamp tx ty tz qx qy qz qw: T_table_camera, seconds and metres\n";
    for (const StampedPose& pose : trajectory) {
      text += format_ns_as_seconds(pose.timestamp_ns);
      for (const double value : pose.T_table_camera.position)
        text += fmt::format(" {:.17g}", value);
      for (const double value : pose.T_table_camera.quaternion_xyzw)
        text += fmt::format(" {:.17g}", value);
      text += "\n";
    }
    throw_if_failed(write_text_file(file, text));
  });
}

Errors evaluate(const CameraModel& camera, const Trajectory& estimated, const Trajectory& truth,
                const Options& options) {
  return guarded([&] {
    const penumbra::Trajectory found = checked(estimated, "estimated");
    const penumbra::Trajectory true_poses = checked(truth, "truth");
    const PairingOptions pairing{checked_ns(options.max_gap_s, 0.0, "max_gap_s"),
                                 checked_ns(options.time_offset_s, -kMaxSeconds, "time_offset_s")};
    const NamedTrajectory named_estimate{found, "estimated"};
    const NamedTrajectory named_truth{true_poses, "truth"};
    const Evaluation evaluation =
        penumbra::evaluate(types::Access::model_of(camera), found, true_poses, pairing);
    Errors errors;
    errors.warnings = value_or_throw(check_units_of_time(named_estimate, named_truth, pairing));
    if (evaluation.frames_judged == 0) {
      throw_failure(
          "estimated: has no pose that can be compared with the truth; are both of the same "
          "recording? time_offset_s shifts the estimate, max_gap_s allows longer gaps");
    }
    if (auto hint = pose_convention_hint(named_estimate, named_truth, pairing)) {
      errors.warnings.push_back(std::move(*hint));
    }
    const auto not_judged = [&](NotEvaluated cause) {
      return evaluation.frames_not_judged[static_cast<std::size_t>(cause)];
    };
    errors.frames_with_truth = evaluation.frames_with_truth;
    errors.frames_estimated = evaluation.frames_estimated;
    errors.frames_judged = evaluation.frames_judged;
    errors.outside_truth = not_judged(NotEvaluated::outside_truth);
    errors.gap_too_long = not_judged(NotEvaluated::gap_too_long);
    errors.translation_mm = to_public(evaluation.translation_mm);
    errors.rotation_deg = to_public(evaluation.rotation_deg);
    errors.overlay_px = to_public(evaluation.overlay_px);
    if (evaluation.jitter_changes > 0) errors.jitter_px = evaluation.jitter_px;
    return errors;
  });
}

}  // namespace penumbra::evaluation
