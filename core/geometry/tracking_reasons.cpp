#include "core/geometry/tracking_reasons.hpp"

#include <fmt/format.h>

#include <array>

namespace penumbra {
namespace {

// Indexed by PoseCause. {0}: error_px, {1}: tags, {2} to {5}: sizes_px, {6}: suspects.
constexpr auto kPoseCauseTexts = std::to_array<std::string_view>({
    "",
    "no tag of the table was found",
    "the same tag is in view twice",
    "{1} tags in view, none of them of this board (--tags)",
    "the corners in view do not determine a pose",
    "few of the tags are seen yet",
    "not where it was",
    "the frame is empty",
    "the frame is {2}x{3}, the camera file says {4}x{5}",
    "no complete frame from the camera",
    "no pose given for this time",
    "no place given for this time",
    "not seen",
    "the table is held",
    "the table is lost",
    "no finite place",
    "no trial is shown",
    "two poses fit",
    "the tags are inconsistent with each other",
    "the tags do not fit the map ({0} px)",
    "the table's centre is out of sight",
    "the lens is known to {0} px only; calibrate the camera from more views",
    "the few tags in view are inconsistent with the map: predicted error {0} px",
    "predicted error {0} px",
    "predicted error {0} px because of the {6}",
    "the table is uncertain: ",
});
static_assert(kPoseCauseTexts.size() == static_cast<std::size_t>(PoseCause::uncertain_table) + 1);

// The numbers of a reason as text: error_px, tags, sizes_px.
using Numbers = std::array<std::string, 6>;

std::string formatted(const PoseReason& reason, const Numbers& numbers) {
  const auto text = [&](PoseCause cause) {
    return fmt::format(fmt::runtime(kPoseCauseTexts[static_cast<std::size_t>(cause)]), numbers[0],
                       numbers[1], numbers[2], numbers[3], numbers[4], numbers[5],
                       text_of(reason.suspects));
  };
  return reason.cause == PoseCause::uncertain_table ? text(reason.cause) + text(reason.of_table)
                                                    : text(reason.cause);
}

// `text`: {0} is the tag's id, {1} the map, {2} the number of frames.
struct RejectionEntry {
  std::string_view key;
  std::string_view text;
};

// Indexed by TagRejection.
constexpr std::array kRejectionTable = {
    RejectionEntry{"tags_left_out",
                   "tag {0} is inconsistent with {1}: rejected in {2} frames (measure it again, or "
                   "make a new map: penumbra map)"},
};
static_assert(kRejectionTable.size() == kTagRejections);

}  // namespace

std::string text_of(const Suspects& suspects) {
  std::string text;
  const auto add = [&](bool suspected, std::string_view name) {
    if (!suspected) return;
    if (!text.empty()) text += suspects.certain ? ", " : " or ";
    text += name;
  };
  add(suspects.tag_map, "tag map");
  add(suspects.lens, "lens");
  add(suspects.row_time, "row time");
  return text;
}

PoseReason reason_by_table(PoseReason table) {
  table.of_table = table.cause;
  table.cause = PoseCause::uncertain_table;
  return table;
}

bool is_same_kind(const PoseReason& a, const PoseReason& b) {
  return a.cause == b.cause && a.of_table == b.of_table && a.suspects == b.suspects;
}

std::string text_of(const PoseReason& reason) {
  const auto& sizes = reason.sizes_px;
  return formatted(reason, {fmt::format("{:.1f}", reason.error_px), std::to_string(reason.tags),
                            std::to_string(sizes[0]), std::to_string(sizes[1]),
                            std::to_string(sizes[2]), std::to_string(sizes[3])});
}

std::string general_text_of(const PoseReason& reason) {
  return formatted(reason, {"N", "N", "N", "N", "N", "N"});
}

std::string_view key_of(TagRejection reason) {
  return kRejectionTable[static_cast<std::size_t>(reason)].key;
}

std::string text_of(TagRejection reason, std::string_view tag, std::string_view map,
                    std::int64_t frames) {
  return fmt::format(fmt::runtime(kRejectionTable[static_cast<std::size_t>(reason)].text), tag, map,
                     frames);
}

}  // namespace penumbra
