#include "app/output/error_log.hpp"

#include <array>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "core/geometry/group_pose.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

// Returns the name of a cause, or null.
template <class Cause>
Json name_or_null(const std::optional<Cause>& cause) {
  return cause ? Json(to_string(*cause)) : Json();
}

Row row_of(const PoseErrors& pose, std::string_view group) {
  const auto judged = [&](double error) {
    return pose.not_judged ? Json() : finite_or_null(error);
  };
  return {time_cell(pose.timestamp_ns),
          {"group", group},
          {"not_judged", name_or_null(pose.not_judged)},
          {"translation_mm", judged(pose.translation_mm)},
          {"rotation_deg", judged(pose.rotation_deg)},
          {"overlay_frame_px", finite_or_null(pose.overlay_px)},
          {"jitter_px", finite_or_null(pose.jitter_px)},
          {"predicted_px", finite_or_null(pose.predicted_px)},
          {"frame_ratio", finite_or_null(pose.ratio)}};
}

Row row_of(const Frame& frame, std::size_t split, const HalfDifference& difference) {
  const auto compared = [&](double px) {
    return difference.rejection ? Json() : finite_or_null(px);
  };
  return {{"frame", frame.sequence},
          time_cell(frame.timestamp_ns),
          utc_cell(frame.utc_ns),
          {"split", split + 1},
          {"rejected", name_or_null(difference.rejection)},
          {"split_half_px", compared(difference.difference_px)},
          {"predicted_px", compared(difference.predicted_px)},
          {"frame_ratio", finite_or_null(difference.ratio())}};
}

// The poses of a group that are not written yet.
struct GroupRows {
  std::string_view name;
  std::span<const PoseErrors> rest;
};

}  // namespace

Result<void> write_pose_errors(const std::filesystem::path& file, const Evaluation& table,
                               const std::map<std::string, Evaluation>& groups) {
  PENUMBRA_TRY(auto log, RowLog::create(file, row_of(PoseErrors(), kTableGroup)));
  std::vector<GroupRows> others;
  for (const auto& [name, evaluation] : groups) others.push_back({name, evaluation.poses});
  for (const PoseErrors& pose : table.poses) {
    std::vector<Row> rows = {row_of(pose, kTableGroup)};
    for (GroupRows& group : others) {
      if (group.rest.empty() || group.rest.front().timestamp_ns != pose.timestamp_ns) continue;
      rows.push_back(row_of(group.rest.front(), group.name));
      group.rest = group.rest.subspan(1);
    }
    PENUMBRA_TRY_VOID(log.write(rows));
  }
  return log.finish();
}

Result<HalfErrorLog> HalfErrorLog::create(const std::filesystem::path& file) {
  PENUMBRA_TRY(auto rows, RowLog::create(file, row_of(Frame(), 0, HalfDifference())));
  return HalfErrorLog(std::move(rows));
}

Result<void> HalfErrorLog::add(const Frame& frame, std::size_t split,
                               const HalfDifference& difference) {
  is_empty_ = false;
  return rows_.write(std::array{row_of(frame, split, difference)});
}

void HalfErrorLog::rescue() {
  if (!is_empty_) rows_.rescue();
}

}  // namespace penumbra
