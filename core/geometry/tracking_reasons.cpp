#include "core/geometry/tracking_reasons.hpp"

#include <fmt/format.h>

#include <array>

namespace penumbra {
namespace {

// Indexed by PoseCause. {0}: PoseReason::error_px, {1}: PoseReason::message.
constexpr auto kPoseCauseTexts = std::to_array<std::string_view>({
    "",
    "{1}",
    "two poses fit",
    "the tags are inconsistent with each other",
    "the tags do not fit the map ({0:.1f} px)",
    "the table's centre is out of sight",
    "the camera file knows its lens to {0:.1f} px only; calibrate it from more views",
    "the few tags in view are inconsistent with the map: predicted error {0:.1f} px",
    "predicted error {0:.1f} px",
    "predicted error {0:.1f} px because of the {1}",
    "the table is uncertain: {1}",
});
static_assert(kPoseCauseTexts.size() == static_cast<std::size_t>(PoseCause::uncertain_table) + 1);

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

std::string text_of(const PoseReason& reason) {
  return fmt::format(fmt::runtime(kPoseCauseTexts[static_cast<std::size_t>(reason.cause)]),
                     reason.error_px, reason.message);
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
