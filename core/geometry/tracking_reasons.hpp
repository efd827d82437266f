// Reasons: why a pose is not tracked, why a tag is rejected. Control flow compares the enumerators;
// their texts are for people and reports.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace penumbra {

enum class PoseCause {
  none,               // tracked
  not_measured,       // PoseReason::message says why
  two_poses,          // either may be the true one
  inconsistent_tags,  // no majority of them fits the map
  misfit,             // no pose fits the tags: the camera file or the map is wrong
  out_of_sight,       // of the table's centre
  uncertain_lens,
  uncertain_map,  // the map has few tags in wrong places
  large_error,
  uncertain_table,  // of another group; PoseReason::message is the table's reason
};

// Reason why a pose is uncertain, held or lost.
struct PoseReason {
  PoseCause cause = PoseCause::none;
  double error_px = 0.0;  // in the text of some causes
  std::string message = {};
};

[[nodiscard]] inline PoseReason not_measured(std::string message) {
  return {PoseCause::not_measured, 0.0, std::move(message)};
}

// Empty without a cause.
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
// The report's line about a tag; `map` names the map.
[[nodiscard]] std::string text_of(TagRejection reason, std::string_view tag, std::string_view map,
                                  std::int64_t frames);

}  // namespace penumbra
