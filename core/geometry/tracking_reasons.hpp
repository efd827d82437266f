// The reasons why a pose is not tracked or a tag is rejected. Compare the enumerators; the texts
// are for users and reports.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace penumbra {

enum class PoseCause {
  none,               // tracked
  not_measured,       // PoseReason::message holds the cause
  two_poses,          // planar pose ambiguity
  inconsistent_tags,  // no majority of the tags agrees with the map
  misfit,             // no pose fits the tags: the camera file or the map is wrong
  out_of_sight,       // the table's centre is outside the image
  uncertain_lens,
  uncertain_map,  // a small error of the map causes a large overlay error
  large_error,
  systematic_error,  // of what PoseReason::message names: the tag map, the lens, the row time
  uncertain_table,   // for a group; PoseReason::message holds the reason of the table's pose
};

// Reason why a pose is uncertain, held or lost.
struct PoseReason {
  PoseCause cause = PoseCause::none;
  double error_px = 0.0;  // predicted or measured error; used by some causes
  std::string message = {};
};

[[nodiscard]] inline PoseReason not_measured(std::string message) {
  return {PoseCause::not_measured, 0.0, std::move(message)};
}

// Returns "" for PoseCause::none.
[[nodiscard]] std::string text_of(const PoseReason& reason);

enum class TagRejection {
  inconsistent,  // with the map: see TagConsensus
};
inline constexpr std::size_t kTagRejections =
    static_cast<std::size_t>(TagRejection::inconsistent) + 1;

struct RejectedTag {
  int id = 0;
  TagRejection reason = TagRejection::inconsistent;

  [[nodiscard]] bool operator==(const RejectedTag&) const = default;
};

// Key in the report.
[[nodiscard]] std::string_view key_of(TagRejection reason);
// Returns the report's line about a rejected tag. `map` is the name of the map.
[[nodiscard]] std::string text_of(TagRejection reason, std::string_view tag, std::string_view map,
                                  std::int64_t frames);

}  // namespace penumbra
