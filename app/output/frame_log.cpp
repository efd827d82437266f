#include "app/output/frame_log.hpp"

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

// A column of a CSV file, or a key of a JSON line. Unknown values are empty, or null in JSON.
struct Cell {
  std::string name;
  Json value;
  std::string csv = {};  // instead of `value` in CSV, if it is more exact
};

Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json();
}

// `pose`: null if it is unknown.
template <class Pose>
void add_pose(std::vector<Cell>& row, const Pose* pose) {
  constexpr std::array kNames = {"tx", "ty", "tz", "qx", "qy", "qz", "qw"};
  Eigen::Matrix<double, 7, 1> values;
  if (pose != nullptr) values << pose->translation(), pose->rotation().coeffs();
  for (std::size_t i = 0; i < kNames.size(); ++i)
    row.push_back(
        {kNames[i], pose != nullptr ? number(values[static_cast<Eigen::Index>(i)]) : Json()});
}

void add_estimate(std::vector<Cell>& row, const EstimatedPose& estimate) {
  const bool has_pose = estimate.has_pose();
  row.push_back({"predicted_px", has_pose ? number(estimate.predicted_overlay_error_px) : Json()});
  row.push_back(
      {"reprojection_px", estimate.tags_used > 0 ? number(estimate.reprojection_rms_px) : Json()});
  row.push_back({"tags_used", estimate.tags_used});
  Json rejected = Json::array();
  for (const RejectedTag& tag : estimate.tags_rejected) rejected.push_back(tag.id);
  row.push_back({"tags_rejected", std::move(rejected)});
  row.push_back({"age_s", has_pose ? number(estimate.age_s) : Json()});
  for (int i = 0; i < 6; ++i) {
    for (int k = i; k < 6; ++k) {
      row.push_back({fmt::format("cov_{}{}", i + 1, k + 1),
                     has_pose ? number(estimate.covariance(i, k)) : Json()});
    }
  }
}

// `frame`: null for a group beside the table, whose row has no times.
void add_times(std::vector<Cell>& row, const SessionFrame* frame) {
  const auto add = [&](const char* name, double time_ms) {
    row.push_back({name, frame != nullptr ? number(time_ms) : Json()});
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

std::vector<Cell> row_start(const Frame& frame, std::string_view group,
                            const EstimatedPose& estimate) {
  return {{"frame", frame.sequence},
          {"timestamp_s", seconds(frame.timestamp_ns), format_ns_as_seconds(frame.timestamp_ns)},
          {"group", group},
          {"state", to_string(estimate.status)},
          {"reason", text_of(estimate.reason)}};
}

std::vector<std::vector<Cell>> rows_of(const SessionFrame& frame) {
  const PoseEstimate& pose = frame.tracked.pose;
  std::vector<std::vector<Cell>> rows;
  std::vector<Cell>& table = rows.emplace_back(row_start(frame.tracked.frame, kTableGroup, pose));
  add_pose(table, pose.has_pose() ? &pose.T_table_camera : nullptr);
  add_estimate(table, pose);
  add_times(table, &frame);
  for (const GroupEstimate& group : frame.tracked.groups) {
    std::vector<Cell>& row = rows.emplace_back(row_start(frame.tracked.frame, group.name, group));
    add_pose(row, group.has_pose() ? &group.T_table_group : nullptr);
    add_estimate(row, group);
    add_times(row, nullptr);
  }
  return rows;
}

std::string csv_text(const Json& value) {
  if (value.is_null()) return {};
  if (value.is_array()) {
    std::string words;
    for (const Json& item : value) words += (words.empty() ? "" : " ") + item.dump();
    return words;
  }
  if (!value.is_string()) return value.dump();
  const std::string& text = value.get_ref<const std::string&>();
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string csv_line(const std::vector<Cell>& row, bool names) {
  std::string line;
  for (const Cell& cell : row) {
    if (&cell != &row.front()) line += ',';
    line += names ? cell.name : cell.csv.empty() ? csv_text(cell.value) : cell.csv;
  }
  return line + "\n";
}

std::string json_line(const std::vector<Cell>& row) {
  Json json;
  for (const Cell& cell : row) json[cell.name] = cell.value;
  return json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace

Result<FrameLog> FrameLog::create(const std::filesystem::path& file) {
  const bool is_jsonl = lower_extension(file.string()) == ".jsonl";
  PENUMBRA_TRY(auto output, OutputFile::create(file));
  FrameLog log(std::move(output), is_jsonl ? FrameLogFormat::jsonl : FrameLogFormat::csv);
  if (!is_jsonl) PENUMBRA_TRY_VOID(log.file_.append(csv_line(rows_of({}).front(), true)));
  return log;
}

Result<void> FrameLog::write(const SessionFrame& frame) {
  std::string text;
  for (const std::vector<Cell>& row : rows_of(frame))
    text += format_ == FrameLogFormat::csv ? csv_line(row, false) : json_line(row);
  return file_.append(text);
}

void FrameLog::rescue() {
  keep_complete_lines(file_);
}

}  // namespace penumbra
