// Which true pose an estimated one is compared with: the truth interpolated at the estimate's time.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/trajectory.hpp"

namespace penumbra {

struct PairingOptions {
  // The truth is interpolated between two of its poses that are at most this far apart [ns]. A hand
  // that accelerates by 5 m/s^2 leaves the straight line by 0.06 mm within 10 ms (motion capture),
  // 0.7 mm within 33 ms and 6 mm within 100 ms.
  std::int64_t max_gap_ns = 100'000'000;
  // Added to the estimate's times [ns].
  std::int64_t time_offset_ns = 0;
};

// Why there is no true pose at a time.
enum class NotJudged {
  outside_truth,  // further before the first or after the last true pose than is extrapolated
  gap_too_long,   // between two that are further apart than PairingOptions::max_gap_ns
};
inline constexpr std::array<NotJudged, 2> kNotJudged = {NotJudged::outside_truth,
                                                        NotJudged::gap_too_long};
[[nodiscard]] std::string_view to_string(NotJudged cause);  // "outside_truth", "gap_too_long"

// The pose at a time. Within 1 us of a pose of the trajectory, it is that pose: files round their
// times. Else it is interpolated (position linearly, rotation by slerp) between the two poses
// around it, where these are at most `max_gap_ns` apart. Before the first and after the last pose
// it is extrapolated by at most half of the interval there, and by at most 10 ms. Elsewhere it is a
// pose within 1 ms, if there is one.
[[nodiscard]] tl::expected<CameraPose, NotJudged> pose_at(const Trajectory& trajectory,
                                                          std::int64_t timestamp_ns,
                                                          std::int64_t max_gap_ns);

// The time with the offset added; the largest or smallest time where the sum would be beyond.
[[nodiscard]] std::int64_t shifted(std::int64_t timestamp_ns, std::int64_t offset_ns);

// Median time between two poses, the lower of two [ns]; 0 for fewer than two poses.
[[nodiscard]] std::int64_t median_interval_ns(const Trajectory& trajectory);

// A trajectory and its name in errors.
struct NamedTrajectory {
  const Trajectory& trajectory;
  std::string_view name;
};
// Fails where poses are less than 10 us apart, or where most of the estimate can't be judged and
// fills the truth's time after it is scaled by 1e3, 1e6 or 1e9. Poses that are 8 s or more apart:
// fails where none can be judged, else returns a warning for each such trajectory.
[[nodiscard]] Result<std::vector<std::string>> check_units_of_time(const NamedTrajectory& estimated,
                                                                   const NamedTrajectory& truth,
                                                                   const PairingOptions& options);

}  // namespace penumbra
