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
  // Maximum gap in the truth that is interpolated [ns]. At an acceleration of 5 m/s^2, linear
  // interpolation over this gap is off by up to 6 mm.
  std::int64_t max_gap_ns = 100'000'000;
  // Added to the estimate's times [ns].
  std::int64_t time_offset_ns = 0;
};

// The reason why there is no true pose at a time.
enum class NotEvaluated {
  outside_truth,  // before the first or after the last true pose, out of the range of extrapolation
  gap_too_long,   // between two poses with a gap of more than PairingOptions::max_gap_ns
};
inline constexpr std::array<NotEvaluated, 2> kNotEvaluatedCauses = {NotEvaluated::outside_truth,
                                                                    NotEvaluated::gap_too_long};
[[nodiscard]] std::string_view to_string(NotEvaluated cause);  // "outside_truth", "gap_too_long"

// Returns the pose at a time by the first rule that applies:
// - a pose within 1 us, since files round their times,
// - interpolated (position linearly, rotation by slerp) across a gap of up to `max_gap_ns`,
// - extrapolated beyond an end, by up to half of the interval at that end but not more than 10 ms,
// - a pose within 1 ms.
[[nodiscard]] tl::expected<CameraPose, NotEvaluated> pose_at(const Trajectory& trajectory,
                                                             std::int64_t timestamp_ns,
                                                             std::int64_t max_gap_ns);

// Adds the offset; saturates at the largest and smallest time.
[[nodiscard]] std::int64_t shifted(std::int64_t timestamp_ns, std::int64_t offset_ns);

// Returns the (lower) median time between two poses [ns], or 0 if there are fewer than two.
[[nodiscard]] std::int64_t median_interval_ns(const Trajectory& trajectory);

// A trajectory and its file's name in errors.
struct NamedTrajectory {
  const Trajectory& trajectory;
  std::string_view name;
};
// Detects timestamps in a wrong unit. Fails in these cases:
// - Poses are less than 10 us apart.
// - Most estimates have no true pose, but would overlap the truth if scaled by 1e3, 1e6 or 1e9.
// - Poses are 8 s or more apart, and no estimate has a true pose.
// Otherwise returns a warning for each trajectory whose poses are 8 s or more apart.
[[nodiscard]] Result<std::vector<std::string>> check_units_of_time(const NamedTrajectory& estimated,
                                                                   const NamedTrajectory& truth,
                                                                   const PairingOptions& options);

}  // namespace penumbra
