// The reasons why a pose is not tracked or a tag is rejected. Compare the enumerators; the texts
// are for users and reports.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace penumbra {

enum class PoseCause {
  none,  // tracked
  // Nothing was measured.
  no_tag,
  tag_twice,          // two detections of the only tag: it is unknown which one is in the map
  tags_not_in_map,    // PoseReason::tags of them
  undetermined,       // the corners in view do not determine a pose
  few_tags,           // of those in view; a finer search follows
  not_followed,       // the tags are not where they were
  empty_frame,        // without pixels
  wrong_size,         // PoseReason::sizes_px
  no_complete_frame,  // from the camera
  no_given_pose,      // for the time of the frame
  no_given_place,     // like no_given_pose, for a group
  group_not_seen,
  table_held,  // a group has no place without a pose of the table
  table_lost,
  no_finite_place,  // of a group
  no_trial,         // of a study is shown
  // The measured pose is uncertain or wrong.
  two_poses,          // planar pose ambiguity
  inconsistent_tags,  // no majority of the tags agrees with the map
  misfit,             // no pose fits the tags: the camera file or the map is wrong
  out_of_sight,       // the table's centre is outside the image
  uncertain_lens,
  uncertain_map,  // a small error of the map causes a large overlay error
  large_error,
  systematic_error,  // of PoseReason::suspects
  uncertain_table,   // for a group; PoseReason::of_table is the cause of the table's pose
};

// Possible causes of systematic residuals.
struct Suspects {
  bool tag_map = false, lens = false, row_time = false;
  bool certain = false;  // true: each of them is wrong; false: one of them
  [[nodiscard]] bool operator==(const Suspects&) const = default;
};

// Returns "lens", "tag map, lens" or "lens or row time".
[[nodiscard]] std::string text_of(const Suspects& suspects);

// Reason why a pose is uncertain, held or lost. Most causes use few of the other members.
struct PoseReason {
  PoseCause cause = PoseCause::none;
  double error_px = 0.0;             // predicted or measured
  int tags = 0;                      // number of tags
  std::array<int, 4> sizes_px = {};  // width and height of the frame, and in the camera file
  PoseCause of_table = PoseCause::none;
  Suspects suspects = {};
};

// Returns a group's reason if the table's pose has the reason `table`.
[[nodiscard]] PoseReason reason_by_table(PoseReason table);

// Returns true if the reasons are equal except for their numbers.
[[nodiscard]] bool is_same_kind(const PoseReason& a, const PoseReason& b);

// Returns "" for PoseCause::none.
[[nodiscard]] std::string text_of(const PoseReason& reason);
// Like text_of(), with N in place of numbers: "predicted error N px".
[[nodiscard]] std::string general_text_of(const PoseReason& reason);

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
