#include "core/evaluation/pairing.hpp"

#include <algorithm>
#include <limits>
#include <optional>
#include <utility>

#include "core/propagate.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

constexpr std::int64_t kSameTime_ns = 1'000;  // covers rounding to microseconds
constexpr std::int64_t kNearTime_ns = 1'000'000;
constexpr std::int64_t kMaxExtrapolation_ns = 10'000'000;  // maximum extrapolation beyond the ends

// Interpolates between two poses, or extrapolates beyond them.
CameraPose interpolated(const StampedPose& before, const StampedPose& after,
                        std::int64_t timestamp_ns) {
  const double interval = static_cast<double>(distance_ns(after.timestamp_ns, before.timestamp_ns));
  const double distance = static_cast<double>(distance_ns(timestamp_ns, before.timestamp_ns));
  const double u = (timestamp_ns < before.timestamp_ns ? -distance : distance) / interval;
  const CameraPose& a = before.T_table_camera;
  const CameraPose& b = after.T_table_camera;
  return {a.rotation().slerp(u, b.rotation()), (1.0 - u) * a.translation() + u * b.translation()};
}

struct TimeUnit {
  const char* name;
  double per_second;
};
constexpr std::array<TimeUnit, 3> kFinerUnits = {
    {{"milliseconds", 1e3}, {"microseconds", 1e6}, {"nanoseconds", 1e9}}};

// Range of plausible intervals between two poses of a video.
constexpr double kMaxInterval_s = 8.0;
constexpr double kMinInterval_s = 1e-5;

// Returns the median interval [s], or nullopt for fewer than three poses.
std::optional<double> median_interval_s(const Trajectory& trajectory) {
  constexpr std::size_t kMinPoses = 3;
  if (trajectory.poses.size() < kMinPoses) return std::nullopt;
  return seconds(median_interval_ns(trajectory));
}

// Returns a warning about the unit of time if the poses are 8 s or more apart.
std::optional<std::string> long_interval_text(const NamedTrajectory& named) {
  const std::optional<double> interval_s = median_interval_s(named.trajectory);
  if (!interval_s || *interval_s < kMaxInterval_s) return std::nullopt;
  // Guesses the unit that corresponds to a video of 0.2 to 200 frames per second.
  const TimeUnit& unit = *interval_s < 5e3   ? kFinerUnits[0]
                         : *interval_s < 5e6 ? kFinerUnits[1]
                                             : kFinerUnits[2];
  return fmt::format(
      "{}: timestamps are {:.6g} s apart (median), far for seconds of a video; if they are {}, "
      "divide them by {:g}",
      named.name, *interval_s, unit.name, unit.per_second);
}

Result<void> check_min_interval(const NamedTrajectory& named) {
  const std::optional<double> interval_s = median_interval_s(named.trajectory);
  if (!interval_s || *interval_s >= kMinInterval_s) return {};
  return fail(
      "{}: timestamps are {:.3g} s apart (median), too near for a video; give them in seconds",
      named.name, *interval_s);
}

// Counts the estimate's times that are, after scaling, within the time span of the truth.
std::size_t count_inside(const Trajectory& estimated, const Trajectory& truth, double scale,
                         const PairingOptions& options) {
  const double first_s = seconds(truth.poses.front().timestamp_ns - kNearTime_ns);
  const double last_s = seconds(truth.poses.back().timestamp_ns + kNearTime_ns);
  return static_cast<std::size_t>(std::ranges::count_if(estimated.poses, [&](const auto& pose) {
    const double time_s = scale * seconds(pose.timestamp_ns) + seconds(options.time_offset_ns);
    return time_s >= first_s && time_s <= last_s;
  }));
}

double duration_s(const Trajectory& trajectory) {
  return seconds(trajectory.poses.back().timestamp_ns) -
         seconds(trajectory.poses.front().timestamp_ns);
}

// Fails if scaling the times of one trajectory by 1e3, 1e6 or 1e9 makes the two overlap.
Result<void> check_same_unit(const NamedTrajectory& estimated, const NamedTrajectory& truth,
                             const PairingOptions& options) {
  const std::vector<StampedPose>& poses = estimated.trajectory.poses;
  for (const TimeUnit& unit : kFinerUnits) {
    for (const bool truth_is_finer : {false, true}) {
      const double scale = truth_is_finer ? unit.per_second : 1.0 / unit.per_second;
      // Requires a similar duration: scaled times that are all near 0 are also inside.
      const double share = scale * duration_s(estimated.trajectory) / duration_s(truth.trajectory);
      const std::size_t inside =
          count_inside(estimated.trajectory, truth.trajectory, scale, options);
      if (!(share > 0.2) || 10 * inside < 9 * poses.size()) continue;
      return fail("{}: timestamps look like {}, those of {} like seconds; divide them by {:g}",
                  truth_is_finer ? truth.name : estimated.name, unit.name,
                  truth_is_finer ? estimated.name : truth.name, unit.per_second);
    }
  }
  return {};
}

}  // namespace

std::string_view to_string(NotEvaluated cause) {
  return cause == NotEvaluated::outside_truth ? "outside_truth" : "gap_too_long";
}

tl::expected<CameraPose, NotEvaluated> pose_at(const Trajectory& trajectory,
                                               std::int64_t timestamp_ns, std::int64_t max_gap_ns) {
  const std::vector<StampedPose>& poses = trajectory.poses;
  const StampedPose* near = trajectory.at(timestamp_ns, kNearTime_ns);
  if (near != nullptr &&
      distance_ns(near->timestamp_ns, timestamp_ns) <= static_cast<std::uint64_t>(kSameTime_ns)) {
    return near->T_table_camera;
  }
  auto after = std::ranges::lower_bound(poses, timestamp_ns, {}, &StampedPose::timestamp_ns);
  const bool inside = after != poses.begin() && after != poses.end();
  if (poses.size() >= 2 && max_gap_ns >= 0) {
    if (after == poses.begin()) ++after;
    if (after == poses.end()) --after;
    const StampedPose& before = *std::prev(after);
    const std::uint64_t gap = distance_ns(after->timestamp_ns, before.timestamp_ns);
    const std::uint64_t beyond = std::min(distance_ns(timestamp_ns, before.timestamp_ns),
                                          distance_ns(timestamp_ns, after->timestamp_ns));
    const bool just_beyond =
        beyond <= std::min(gap / 2, static_cast<std::uint64_t>(kMaxExtrapolation_ns));
    if (gap <= static_cast<std::uint64_t>(max_gap_ns) && (inside || just_beyond))
      return interpolated(before, *after, timestamp_ns);
  }
  if (near != nullptr) return near->T_table_camera;
  return tl::unexpected(inside ? NotEvaluated::gap_too_long : NotEvaluated::outside_truth);
}

std::int64_t shifted(std::int64_t timestamp_ns, std::int64_t offset_ns) {
  std::int64_t sum = 0;
  if (!__builtin_add_overflow(timestamp_ns, offset_ns, &sum)) return sum;
  return offset_ns > 0 ? std::numeric_limits<std::int64_t>::max()
                       : std::numeric_limits<std::int64_t>::min();
}

std::int64_t median_interval_ns(const Trajectory& trajectory) {
  std::vector<std::int64_t> intervals;
  for (std::size_t i = 1; i < trajectory.poses.size(); ++i) {
    intervals.push_back(trajectory.poses[i].timestamp_ns - trajectory.poses[i - 1].timestamp_ns);
  }
  if (intervals.empty()) return 0;
  const auto middle = intervals.begin() + static_cast<std::ptrdiff_t>((intervals.size() - 1) / 2);
  std::ranges::nth_element(intervals, middle);
  return *middle;
}

Result<std::vector<std::string>> check_units_of_time(const NamedTrajectory& estimated,
                                                     const NamedTrajectory& truth,
                                                     const PairingOptions& options) {
  for (const NamedTrajectory& named : {estimated, truth}) {
    PENUMBRA_TRY_VOID(check_min_interval(named));
  }
  const std::vector<StampedPose>& poses = estimated.trajectory.poses;
  const auto judged = std::ranges::count_if(poses, [&](const StampedPose& pose) {
    return pose_at(truth.trajectory, shifted(pose.timestamp_ns, options.time_offset_ns),
                   options.max_gap_ns)
        .has_value();
  });
  const bool few_evaluated = 2 * static_cast<std::size_t>(judged) < poses.size();
  if (few_evaluated && poses.size() >= 2 && truth.trajectory.poses.size() >= 2) {
    PENUMBRA_TRY_VOID(check_same_unit(estimated, truth, options));
  }
  std::vector<std::string> warnings;
  for (const NamedTrajectory& named : {estimated, truth}) {
    std::optional<std::string> text = long_interval_text(named);
    if (!text) continue;
    if (judged == 0) return tl::unexpected(Error{*text});
    warnings.push_back(std::move(*text));
  }
  return warnings;
}

}  // namespace penumbra
