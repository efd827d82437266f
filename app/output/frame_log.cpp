#include "app/output/frame_log.hpp"

#include <array>
#include <nlohmann/json.hpp>
#include <string_view>
#include <utility>
#include <vector>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

// `pose`: null if it is unknown.
template <class Pose>
void add_pose(Row& row, const Pose* pose) {
  constexpr std::array kNames = {"tx", "ty", "tz", "qx", "qy", "qz", "qw"};
  Eigen::Matrix<double, 7, 1> values;
  if (pose != nullptr) values << pose->translation(), pose->rotation().coeffs();
  for (std::size_t i = 0; i < kNames.size(); ++i)
    row.push_back({kNames[i], pose != nullptr ? finite_or_null(values[static_cast<Eigen::Index>(i)])
                                              : Json()});
}

void add_estimate(Row& row, const EstimatedPose& estimate) {
  const bool has_pose = estimate.has_pose();
  row.push_back(
      {"predicted_px", has_pose ? finite_or_null(estimate.predicted_overlay_error_px) : Json()});
  row.push_back({"reprojection_px",
                 estimate.tags_used > 0 ? finite_or_null(estimate.reprojection_rms_px) : Json()});
  row.push_back({"tags_used", estimate.tags_used});
  Json rejected = Json::array();
  for (const RejectedTag& tag : estimate.tags_rejected) rejected.push_back(tag.id);
  row.push_back({"tags_rejected", std::move(rejected)});
  row.push_back({"age_s", has_pose ? finite_or_null(estimate.age_s) : Json()});
  for (int i = 0; i < 6; ++i) {
    for (int k = i; k < 6; ++k) {
      row.push_back({fmt::format("cov_{}{}", i + 1, k + 1),
                     has_pose ? finite_or_null(estimate.covariance(i, k)) : Json()});
    }
  }
}

// `frame`: null for a group beside the table, whose row has no times.
void add_times(Row& row, const SessionFrame* frame) {
  const auto add = [&](const char* name, double time_ms) {
    row.push_back({name, frame != nullptr ? finite_or_null(time_ms) : Json()});
  };
  const TrackTimes times = frame != nullptr ? frame->tracked.times : TrackTimes();
  add("track_ms", times.total_ms);
  add("detect_ms", times.detect_ms);
  add("align_ms", times.align_ms);
  add("solve_ms", times.solve_ms);
  add("plan_ms", frame != nullptr ? frame->plan_time.wall_ms : 0.0);
  add("shadow_ms", frame != nullptr ? frame->composite.shadow_ms : 0.0);
  add("render_ms", frame != nullptr ? frame->composite.render_ms : 0.0);
  add("draw_ms", frame != nullptr ? frame->draw_time.wall_ms : 0.0);
}

Row row_start(const Frame& frame, std::string_view group, const EstimatedPose& estimate) {
  return {{"frame", frame.sequence},
          time_cell(frame.timestamp_ns),
          utc_cell(frame.utc_ns),
          {"group", group},
          {"state", to_string(estimate.status)},
          {"reason", text_of(estimate.reason)}};
}

std::vector<Row> rows_of(const SessionFrame& frame) {
  const PoseEstimate& pose = frame.tracked.pose;
  std::vector<Row> rows;
  Row& table = rows.emplace_back(row_start(frame.tracked.frame, kTableGroup, pose));
  add_pose(table, pose.has_pose() ? &pose.T_table_camera : nullptr);
  add_estimate(table, pose);
  add_times(table, &frame);
  for (const GroupEstimate& group : frame.tracked.groups) {
    Row& row = rows.emplace_back(row_start(frame.tracked.frame, group.name, group));
    add_pose(row, group.has_pose() ? &group.T_table_group : nullptr);
    add_estimate(row, group);
    add_times(row, nullptr);
  }
  return rows;
}

}  // namespace

Result<FrameLog> FrameLog::create(const std::filesystem::path& file) {
  PENUMBRA_TRY(auto rows, RowLog::create(file, rows_of({}).front()));
  return FrameLog(std::move(rows));
}

Result<void> FrameLog::write(const SessionFrame& frame) {
  return rows_.write(rows_of(frame));
}

}  // namespace penumbra
