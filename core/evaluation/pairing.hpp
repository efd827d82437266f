// Pairs estimated poses with true ones: the truth interpolated at the estimate's time.
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
  // The truth is interpolated between two of its poses that are at most this far apart [ns]. An
  // acceleration of 5 m/s^2 then leaves the straight line by at most 6 mm.
  std::int64_t max_gap_ns = 100'000'000;
  // Added to the estimate's times [ns].
  std::int64_t time_offset_ns = 0;
};

// The reason why there is no true pose at a time.
enum class NotJudged {
  outside_truth,  // further before the first or after the last true pose than is extrapolated
  gap_too_long,   // between two that are further apart than PairingOptions::max_gap_ns
};
inline constexpr std::array<NotJudged, 2> kNotJudged = {NotJudged::outside_truth,
                                                        NotJudged::gap_too_long};
[[nodiscard]] std::string_view to_string(NotJudged cause);  // "outside_truth", "gap_too_long"

// The pose at a time, the first of these that applies:
// - a pose within 1 us, since files round their times,
// - interpolated (position linearly, rotation by slerp) between two poses at most `max_gap_ns`
// apart,
// - extrapolated beyond an end by at most half of the interval there and at most 10 ms,
// - a pose within 1 ms.
[[nodiscard]] tl::expected<CameraPose, NotJudged> pose_at(const Trajectory& trajectory,
                                                          std::int64_t timestamp_ns,
                                                          std::int64_t max_gap_ns);

// Adds the offset; saturates at the largest and smallest time.
[[nodiscard]] std::int64_t shifted(std::int64_t timestamp_ns, std::int64_t offset_ns);

// Median time between two poses, the lower of two [ns]; 0 for fewer than two poses.
[[nodiscard]] std::int64_t median_interval_ns(const Trajectory& trajectory);

// A trajectory and its name in errors.
struct NamedTrajectory {
  const Trajectory& trajectory;
  std::string_view name;
};
// Fails if poses are less than 10 us apart, or if most of the estimate has no true pose but covers
// the truth's time after scaling by 1e3, 1e6 or 1e9. For poses that are 8 s or more apart: fails if
// no estimate has a true pose, else returns a warning for each such trajectory.
[[nodiscard]] Result<std::vector<std::string>> check_units_of_time(const NamedTrajectory& estimated,
                                                                   const NamedTrajectory& truth,
                                                                   const PairingOptions& options);

}  // namespace penumbra
