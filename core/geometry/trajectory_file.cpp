// Reads TUM files, EuRoC's ground truth and frame logs; writes TUM files.
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kLargestTrajectoryFile = std::size_t{256} << 20U;

// Columns of a TUM file.
constexpr std::array<std::string_view, 8> kColumns = {"timestamp", "tx", "ty", "tz",
                                                      "qx",        "qy", "qz", "qw"};
using PoseFields = std::array<std::string_view, kColumns.size()>;

// Parses position and quaternion. The caller adds file and line to errors.
Result<CameraPose> parse_placement(const PoseFields& fields) {
  std::array<double, kColumns.size()> values{};
  for (std::size_t i = 1; i < fields.size(); ++i) {
    const std::optional<double> value = parse_number(fields[i]);
    if (!value || !std::isfinite(*value)) {
      return fail("{}: '{}' is not a finite number; leave out frames that have no pose",
                  kColumns[i], fields[i]);
    }
    constexpr double kFarthest_m = 1e9;  // a larger position is in a wrong unit
    if (i <= 3 && std::abs(*value) > kFarthest_m) {
      return fail("{}: {} is not a position in metres; give metres in the table's frame",
                  kColumns[i], fields[i]);
    }
    values[i] = *value;
  }
  const Eigen::Quaterniond rotation(values[7], values[4], values[5], values[6]);
  const double norm = rotation.norm();
  if (!(std::abs(norm - 1.0) <= 1e-3)) {
    return fail(
        "qx qy qz qw: the quaternion has length {:.6g}, so it is not a rotation; it must be 1",
        norm);
  }
  return CameraPose(rotation, Eigen::Vector3d(values[1], values[2], values[3]));
}

tl::unexpected<Error> fail_with_time(std::string_view text) {
  const std::optional<double> value = parse_number(text);
  // Unix times in seconds have 10 digits until the year 2286.
  constexpr double kLargest_s = 4e9;
  if (value && std::isfinite(*value) && std::abs(*value) > kLargest_s) {
    const double size = std::abs(*value) / kLargest_s;
    const auto [unit, factor] = size <= 1e3   ? std::pair("milliseconds", "1e3")
                                : size <= 1e6 ? std::pair("microseconds", "1e6")
                                              : std::pair("nanoseconds", "1e9");
    return fail("timestamp: {} is too large for seconds, by its size it is {}; divide by {}", text,
                unit, factor);
  }
  return fail("timestamp: '{}' is not a time; give it in seconds, as a decimal number", text);
}

// Parses "timestamp tx ty tz qx qy qz qw". The caller adds file and line to errors.
Result<StampedPose> parse_tum_pose(std::string_view text) {
  PoseFields fields;
  std::size_t count = 0;
  constexpr std::string_view kBlank = " \t\r\v\f";
  while (true) {
    const std::size_t start = text.find_first_not_of(kBlank);
    if (start == std::string_view::npos) break;
    text.remove_prefix(start);
    const std::size_t length = std::min(text.find_first_of(kBlank), text.size());
    if (count < fields.size()) fields[count] = text.substr(0, length);
    ++count;
    text.remove_prefix(length);
  }
  if (count != fields.size()) {
    return fail("has {} values; write the 8 of a TUM line, timestamp tx ty tz qx qy qz qw", count);
  }
  const std::optional<std::int64_t> time = parse_seconds_as_ns(fields[0]);
  if (!time) return fail_with_time(fields[0]);
  PENUMBRA_TRY(const CameraPose pose, parse_placement(fields));
  return StampedPose{*time, pose, {}};
}

std::vector<std::string_view> split_at_commas(std::string_view text) {
  std::vector<std::string_view> fields = split(text, ',');
  for (std::string_view& field : fields) field = trim(field);
  return fields;
}

// Parses whole nanoseconds, including the form "1.403636580838555648e+18".
std::optional<std::int64_t> parse_whole_ns(std::string_view text) {
  const std::size_t e = text.find_first_of("eE");
  if (e == std::string_view::npos) {
    // A number with decimals is probably in seconds.
    const std::size_t point = text.find('.');
    if (point != std::string_view::npos &&
        text.find_first_not_of('0', point + 1) != std::string_view::npos) {
      return std::nullopt;
    }
    return parse_seconds_as_ns(fmt::format("{}e-9", text));
  }
  const std::optional<std::int64_t> exponent = parse_integer(text.substr(e + 1));
  constexpr std::int64_t kMaxExponent = 100;
  if (!exponent || *exponent > kMaxExponent || *exponent < -kMaxExponent) return std::nullopt;
  return parse_seconds_as_ns(fmt::format("{}e{}", text.substr(0, e), *exponent - 9));
}

// Returns true if the header has w in column 7 (from 0). EuRoC's data sets have w in column 4.
bool header_has_w_last(const std::vector<std::string_view>& header) {
  const auto names_w = [&](std::size_t column) {
    if (column >= header.size()) return false;
    const std::string_view name = header[column].substr(0, header[column].find_first_of(" ["));
    return !name.empty() && (name.back() == 'w' || name.back() == 'W');
  };
  return names_w(7) && !names_w(4);
}

Result<StampedPose> parse_euroc_pose(std::string_view text, bool w_last) {
  const std::vector<std::string_view> row = split_at_commas(text);
  if (row.size() < kColumns.size()) {
    return fail(
        "has {} values between commas; EuRoC's ground truth has 8 or more: timestamp [ns], "
        "position x y z, quaternion w x y z",
        row.size());
  }
  const std::optional<std::int64_t> time = parse_whole_ns(row[0]);
  if (!time) {
    return fail(
        "timestamp: '{}' is not a whole number of nanoseconds, as EuRoC's files have; for times in "
        "seconds write a TUM file, with blanks between the values",
        row[0]);
  }
  PoseFields fields;
  std::copy_n(row.begin(), fields.size(), fields.begin());
  if (!w_last) std::rotate(fields.begin() + 4, fields.begin() + 5, fields.end());
  PENUMBRA_TRY(const CameraPose pose, parse_placement(fields));
  return StampedPose{*time, pose, {}};
}

// Splits a line of CSV, whose fields may be in quotes (RFC 4180, without line breaks).
std::vector<std::string> split_csv(std::string_view line) {
  std::vector<std::string> fields(1);
  bool quoted = false;
  for (std::size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (c == '"' && quoted && line.substr(i + 1).starts_with('"')) {
      fields.back() += line[++i];
    } else if (c == '"') {
      quoted = !quoted;
    } else if (c == ',' && !quoted) {
      fields.emplace_back();
    } else {
      fields.back() += c;
    }
  }
  return fields;
}

// Reads the tracked poses of the camera from the rows of a frame log (docs/files.md#frame-logs).
class FrameLogRows {
 public:
  [[nodiscard]] static bool is_header(std::string_view line) {
    const std::vector<std::string> names = split_csv(line);
    return std::ranges::find(names, kTime) != names.end() &&
           std::ranges::find(names, kState) != names.end();
  }

  // Fails if a column is missing.
  static Result<FrameLogRows> make(std::string_view header) {
    FrameLogRows rows;
    const std::vector<std::string> names = split_csv(header);
    rows.count_ = names.size();
    const auto column_of = [&](std::string_view name) -> Result<std::size_t> {
      const auto found = std::ranges::find(names, name);
      if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
      return fail("has no column {}, which a frame log of --frame-log has", name);
    };
    PENUMBRA_TRY(rows.columns_[0], column_of(kTime));
    for (std::size_t i = 1; i < kColumns.size(); ++i) {
      PENUMBRA_TRY(rows.columns_[i], column_of(kColumns[i]));
    }
    PENUMBRA_TRY(rows.group_, column_of("group"));
    PENUMBRA_TRY(rows.state_, column_of(kState));
    PENUMBRA_TRY(rows.predicted_, column_of("predicted_px"));
    return rows;
  }

  // Returns nullopt for other groups and states; counts the latter.
  [[nodiscard]] Result<std::optional<StampedPose>> read(std::string_view line) {
    const std::vector<std::string> row = split_csv(line);
    if (row.size() != count_)
      return fail("has {} values between commas; the first line names {}", row.size(), count_);
    if (row[group_] != kTableGroup) return std::optional<StampedPose>();
    if (row[state_] != to_string(TrackStatus::tracked)) {
      ++untracked_;
      return std::optional<StampedPose>();
    }
    PoseFields fields;
    for (std::size_t i = 0; i < fields.size(); ++i) fields[i] = row[columns_[i]];
    const std::optional<std::int64_t> time = parse_seconds_as_ns(fields[0]);
    if (!time) return fail_with_time(fields[0]);
    PENUMBRA_TRY(const CameraPose pose, parse_placement(fields));
    StampedPose stamped{*time, pose, {}};
    if (const std::string& text = row[predicted_]; !text.empty()) {
      stamped.predicted_px = parse_number(text);
      if (!(stamped.predicted_px >= 0.0) || !std::isfinite(*stamped.predicted_px))
        return fail("predicted_px: '{}' is not a number of pixels", text);
    }
    return std::optional(stamped);
  }
  [[nodiscard]] int untracked() const { return untracked_; }

 private:
  static constexpr std::string_view kTime = "timestamp_s";
  static constexpr std::string_view kState = "state";
  std::size_t count_ = 0;
  std::array<std::size_t, kColumns.size()> columns_{};  // of time and pose
  std::size_t group_ = 0, state_ = 0, predicted_ = 0;
  int untracked_ = 0;
};

// Reads a file of any format line by line. The caller adds file and line to errors.
class TrajectoryReader {
 public:
  Result<void> read(std::string_view line) {
    if (frame_log_) {
      if (trim(line).empty()) return {};
      PENUMBRA_TRY(auto pose, frame_log_->read(trim(line)));
      return pose ? add(std::move(*pose)) : Result<void>();
    }
    std::string comment;
    if (const std::size_t hash = line.find('#'); hash != std::string_view::npos) {
      comment = trim(line.substr(hash + 1));
      line = line.substr(0, hash);
    }
    line = trim(line);
    std::vector<StampedPose>& poses = trajectory_.poses;
    if (line.empty()) {
      if (poses.empty()) read_header(comment);
      return {};
    }
    const bool commas = line.find(',') != std::string_view::npos;
    if (poses.empty()) {
      if (line.starts_with('{'))
        return fail("is JSON; give a TUM file, or a frame log in CSV (--frame-log FILE.csv)");
      if (FrameLogRows::is_header(line)) {
        PENUMBRA_TRY(frame_log_, FrameLogRows::make(line));
        return {};
      }
      // The header may lack the '#'.
      if (commas && line.find("time") != std::string_view::npos) {
        read_header(line);
        return {};
      }
      trajectory_.of_body = commas;
    }
    PENUMBRA_TRY(StampedPose pose,
                 trajectory_.of_body ? parse_euroc_pose(line, w_last_) : parse_tum_pose(line));
    pose.comment = std::move(comment);
    return add(std::move(pose));
  }
  [[nodiscard]] Trajectory take() {
    if (frame_log_) trajectory_.untracked = frame_log_->untracked();
    return std::move(trajectory_);
  }

 private:
  Result<void> add(StampedPose pose) {
    std::vector<StampedPose>& poses = trajectory_.poses;
    if (!poses.empty() && pose.timestamp_ns < poses.back().timestamp_ns) {
      return fail("timestamp: {} s is before that of the pose above; sort the poses by time",
                  format_ns_as_seconds(pose.timestamp_ns));
    }
    if (!poses.empty() && pose.timestamp_ns == poses.back().timestamp_ns) {
      return fail(
          "timestamp: {} s is that of the pose above too; timestamps must increase: write enough "
          "decimals, and no pose twice",
          format_ns_as_seconds(pose.timestamp_ns));
    }
    poses.push_back(std::move(pose));
    return {};
  }

  void read_header(std::string_view text) {
    if (text.find(',') == std::string_view::npos) return;
    w_last_ = header_has_w_last(split_at_commas(text));
  }

  Trajectory trajectory_;
  bool w_last_ = false;
  std::optional<FrameLogRows> frame_log_;
};

}  // namespace

Result<Trajectory> load_trajectory(const std::filesystem::path& file) {
  PENUMBRA_TRY(const std::string text, read_text_file(file, kLargestTrajectoryFile));
  TrajectoryReader reader;
  std::string_view rest = text;
  for (int line = 1; !rest.empty(); ++line) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    if (auto ok = reader.read(rest.substr(0, end)); !ok)
      return fail_in(fmt::format("{}: line {}", file.string(), line), ok.error());
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
  return reader.take();
}

std::string format_tum(const StampedPose& pose) {
  const Eigen::Vector3d& t = pose.T_table_camera.translation();
  const Eigen::Quaterniond& q = pose.T_table_camera.rotation();
  std::string line = fmt::format("{} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g}",
                                 format_ns_as_seconds(pose.timestamp_ns), t.x(), t.y(), t.z(),
                                 q.x(), q.y(), q.z(), q.w());
  if (!pose.comment.empty()) {
    line += " # " + pose.comment;
    std::ranges::replace(line, '\n', ' ');
    std::ranges::replace(line, '\r', ' ');
  }
  return line;
}

Result<void> save_trajectory(const std::filesystem::path& file, const Trajectory& trajectory) {
  std::string text = "# timestamp tx ty tz qx qy qz qw: T_table_camera, seconds and metres\n";
  for (const StampedPose& pose : trajectory.poses) text += format_tum(pose) + "\n";
  return write_text_file(file, text);
}

}  // namespace penumbra
