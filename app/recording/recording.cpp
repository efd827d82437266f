// The listing of a recording.
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>

#include "app/recording/recording_source.hpp"
#include "app/recording/video_reader.hpp"
#include "app/tags_in_use.hpp"
#include "core/camera/camera_file.hpp"
#include "core/camera/camera_plausibility.hpp"
#include "core/camera/sensor_file.hpp"
#include "core/image/image_file.hpp"
#include "core/image/sample_depth.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxListBytes = 256'000'000;
constexpr std::int64_t kMaxFrameNumber = 999'999'999;  // nine digits in a picture's name
constexpr double kMaxExposure_s = 60.0;
constexpr std::int64_t kMaxTimeNs = 4'000'000'000'000'000'000;  // differences fit into 64 bits

bool is_there(const std::filesystem::path& path) {
  std::error_code ignored;
  return std::filesystem::exists(path, ignored);
}

bool is_folder(const std::filesystem::path& path) {
  std::error_code ignored;
  return std::filesystem::is_directory(path, ignored);
}

// Nothing at that place, as a recording that was cut off leaves it; a place that may not be looked
// into is something else.
bool is_missing(const std::filesystem::path& path) {
  std::error_code ignored;
  return std::filesystem::status(path, ignored).type() == std::filesystem::file_type::not_found;
}

Result<void> check_readable(const std::filesystem::path& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  const bool folder = std::filesystem::is_directory(status);
  if (status.type() == std::filesystem::file_type::none) {
    return fail("{}: cannot be read: {}; see who may read it", path.string(), error.message());
  }
  if (access(path.c_str(), folder ? R_OK | X_OK : R_OK) != 0) {
    return fail("{}: cannot be read: {}; see who may read it", path.string(),
                std::generic_category().message(errno));
  }
  return {};
}

std::string name_of(const std::filesystem::path& folder) {
  std::error_code error;
  const std::filesystem::path whole = std::filesystem::canonical(folder, error);
  return error || whole.filename().empty() ? folder.string() : whole.filename().string();
}

// What is printed of a line that may be anything.
std::string shown(std::string_view text) {
  std::string out;
  for (const char c : text.substr(0, 40)) out.push_back(c >= ' ' && c <= '~' ? c : '?');
  if (text.size() > 40) out += "...";
  return out;
}

struct Row {
  int line = 0;
  bool ended = true;  // with a line break: the last line of a file that was cut off has none
  std::vector<std::string_view> fields;
};

// Comma-separated rows; empty lines and comments are left out. EuRoC's header is a comment too: the
// first one that speaks of a timestamp.
std::vector<Row> split_rows(std::string_view text) {
  std::vector<Row> rows;
  for (int line = 1; !text.empty(); ++line) {
    const std::size_t end = text.find('\n');
    std::string_view content = text.substr(0, end);
    text = end == std::string_view::npos ? std::string_view() : text.substr(end + 1);
    std::string_view body = trim(content);
    if (rows.empty() && body.starts_with('#') && body.find("timestamp") != body.npos) {
      body = trim(body.substr(1));
    } else if (body.starts_with('#')) {
      continue;
    }
    if (body.empty()) continue;
    Row row{line, end != std::string_view::npos, {}};
    while (true) {
      const std::size_t comma = body.find(',');
      row.fields.push_back(trim(body.substr(0, comma)));
      if (comma == std::string_view::npos) break;
      body.remove_prefix(comma + 1);
    }
    rows.push_back(std::move(row));
  }
  return rows;
}

// A picture's path in a listing stays inside the recording.
bool stays_inside(const std::filesystem::path& path) {
  return path.is_relative() &&
         std::none_of(path.begin(), path.end(), [](const auto& part) { return part == ".."; });
}

using RowReader = std::function<Result<RecordedFrame>(const Row&)>;

Result<void> read_rows(const std::vector<Row>& rows, const std::string& csv, const RowReader& read,
                       Recording& recording) {
  for (std::size_t i = 1; i < rows.size(); ++i) {
    const Row& row = rows[i];
    Result<RecordedFrame> frame = read(row);
    if (frame && !recording.frames.empty()) {
      const RecordedFrame& before = recording.frames.back();
      if (frame->number <= before.number) {
        frame = fail(
            "{}: line {}: frame: {} does not come after {} of the line before; number "
            "frames in order",
            csv, row.line, frame->number, before.number);
      } else if (frame->timestamp_ns <= before.timestamp_ns) {
        frame = fail(
            "{}: line {}: timestamp: {} s does not come after {} s of the line before; "
            "times must grow",
            csv, row.line, format_ns_as_seconds(frame->timestamp_ns),
            format_ns_as_seconds(before.timestamp_ns));
      }
    }
    if (!frame) {
      // Being cut off in the middle of its last line is how a listing ends after a crash.
      if (i + 1 == rows.size() && !row.ended && !recording.frames.empty()) {
        recording.notices.push_back(
            fmt::format("{}: line {} is cut off and left out", csv, row.line));
        return {};
      }
      return tl::unexpected(frame.error());
    }
    recording.frames.push_back(std::move(*frame));
  }
  return {};
}

Result<void> list_own(const std::filesystem::path& folder, Recording& recording) {
  const std::filesystem::path csv_file = folder / "timestamps.csv";
  const std::string csv = csv_file.string();
  if (!is_there(csv_file)) {
    return fail("{}: no such file; a recording needs it, with the lines frame,timestamp_s,file",
                csv);
  }
  PENUMBRA_TRY(const auto text, read_text_file(csv_file, kMaxListBytes));
  const std::vector<Row> rows = split_rows(text);
  if (rows.empty()) {
    return fail("{}: is empty; its first line must be frame,timestamp_s,file", csv);
  }
  const auto& header = rows.front().fields;
  const auto column = [&](std::string_view name) {
    const auto found = std::find(header.begin(), header.end(), name);
    return found == header.end() ? std::optional<std::size_t>()
                                 : static_cast<std::size_t>(found - header.begin());
  };
  const auto number_column = column("frame");
  const auto time_column = column("timestamp_s");
  const auto file_column = column("file");
  const auto exposure_column = column("exposure_s");
  const bool pictures = recording.video.empty();
  if (!number_column || !time_column || (pictures && !file_column)) {
    return fail("{}: line {}: has no column {}; the first line must be frame,timestamp_s,file", csv,
                rows.front().line,
                !number_column ? "frame" : (!time_column ? "timestamp_s" : "file"));
  }
  for (const std::string_view name : header) {
    if (!name.starts_with("exposure") || name == "exposure_s") continue;
    recording.notices.push_back(
        fmt::format("{}: column {}: is not read; exposures are read from exposure_s, in seconds",
                    csv, shown(name)));
  }
  const auto read = [&](const Row& row) -> Result<RecordedFrame> {
    if (row.fields.size() != header.size()) {
      return fail("{}: line {}: has {} fields; the first line names {}", csv, row.line,
                  row.fields.size(), header.size());
    }
    RecordedFrame frame;
    const std::string_view number = row.fields[*number_column];
    const auto parsed_number = parse_integer(number);
    if (!parsed_number || *parsed_number < 0 || *parsed_number > kMaxFrameNumber) {
      return fail("{}: line {}: frame: '{}' is no frame number (0, 1, 2, ...)", csv, row.line,
                  shown(number));
    }
    frame.number = static_cast<int>(*parsed_number);
    const std::string_view time = row.fields[*time_column];
    const auto parsed_time = parse_seconds_as_ns(time);
    if (!parsed_time) {
      return fail("{}: line {}: timestamp_s: '{}' is no finite number of seconds", csv, row.line,
                  shown(time));
    }
    frame.timestamp_ns = *parsed_time;
    if (exposure_column && !row.fields[*exposure_column].empty()) {
      const std::string_view exposure = row.fields[*exposure_column];
      frame.exposure_s = parse_number(exposure);
      if (!frame.exposure_s || !(*frame.exposure_s > 0.0 && *frame.exposure_s <= kMaxExposure_s)) {
        return fail("{}: line {}: exposure_s: '{}' is no time above 0 and up to {} s", csv,
                    row.line, shown(exposure), kMaxExposure_s);
      }
    }
    if (pictures) {
      const std::string_view file = row.fields[*file_column];
      if (file.empty() || file.find('\0') != std::string_view::npos || !stays_inside(file)) {
        return fail("{}: line {}: file: '{}' is no path inside the recording", csv, row.line,
                    shown(file));
      }
      frame.file = folder / file;
    }
    return frame;
  };
  if (auto listed = read_rows(rows, csv, read, recording); !listed) return listed;
  if (recording.frames.empty()) {
    return fail("{}: lists 0 frames; record again, or list the frames there are", csv);
  }
  return {};
}

Result<void> list_euroc(const std::filesystem::path& cam0, Recording& recording) {
  const std::filesystem::path csv_file = cam0 / "data.csv";
  const std::string csv = csv_file.string();
  PENUMBRA_TRY(const auto text, read_text_file(csv_file, kMaxListBytes));
  const std::vector<Row> rows = split_rows(text);
  if (rows.empty() || rows.front().fields.size() < 2 ||
      !rows.front().fields[0].starts_with("timestamp")) {
    return fail("{}: line 1: must be #timestamp [ns],filename", csv);
  }
  int number = 0;
  const auto read = [&](const Row& row) -> Result<RecordedFrame> {
    if (row.fields.size() < 2) {
      return fail("{}: line {}: has no file name after the timestamp", csv, row.line);
    }
    RecordedFrame frame;
    frame.number = number++;
    const auto time = parse_integer(row.fields[0]);
    if (!time || *time > kMaxTimeNs || *time < -kMaxTimeNs) {
      return fail("{}: line {}: timestamp: '{}' is no whole number of nanoseconds", csv, row.line,
                  shown(row.fields[0]));
    }
    frame.timestamp_ns = *time;
    const std::string_view file = row.fields[1];
    if (file.empty() || file.find('\0') != std::string_view::npos || !stays_inside(file)) {
      return fail("{}: line {}: filename: '{}' is no path inside the recording", csv, row.line,
                  shown(file));
    }
    frame.file = cam0 / "data" / file;
    return frame;
  };
  if (auto listed = read_rows(rows, csv, read, recording); !listed) return listed;
  if (recording.frames.empty())
    return fail("{}: lists 0 frames; record again, or list the frames there are", csv);
  return {};
}

// Drops the frames at the end that are missing or incomplete, as a crash or a full disk leaves
// them. A frame missing before them is an error.
Result<void> settle_pictures(Recording& recording) {
  const std::size_t listed = recording.frames.size();
  std::string first_cause;  // of the first frame that is dropped
  while (!recording.frames.empty()) {
    const std::filesystem::path& file = recording.frames.back().file;
    std::error_code ignored;
    if (is_missing(file)) {
      first_cause = fmt::format("{}: is missing", file.string());
    } else if (auto readable = check_readable(file); !readable) {
      return readable;
    } else if (recording.frames.size() > 1 &&
               (file / "").lexically_normal() ==
                   ((recording.frames.end() - 2)->file.parent_path() / "").lexically_normal()) {
      first_cause = fmt::format("{}: the end of its name is missing in the listing", file.string());
    } else if (!std::filesystem::is_regular_file(file, ignored)) {
      return fail("{}: is not a file; a recording's frames are files", file.string());
    } else if (const auto picture = load_image(file); !picture) {
      first_cause = picture.error().message;
    } else {
      break;
    }
    recording.frames.pop_back();
  }
  if (recording.frames.empty()) {
    return fail("{}; none of the {} listed frames can be decoded", first_cause, listed);
  }
  for (const RecordedFrame& frame : recording.frames) {
    if (!is_missing(frame.file)) {
      if (auto readable = check_readable(frame.file); !readable) return readable;
    } else {
      return fail(
          "{}: is listed but missing, and later frames exist; restore it, or remove its line from "
          "the listing",
          frame.file.string());
    }
  }
  if (recording.frames.size() < listed) {
    recording.notices.push_back(
        fmt::format("{}: cut off after frame {}, {} of {} frames ({})", recording.folder.string(),
                    recording.frames.back().number, recording.frames.size(), listed, first_cause));
  }
  return {};
}

Result<void> settle_video(Recording& recording) {
  PENUMBRA_TRY(const int count, count_video_frames(recording.video));
  const auto stored = static_cast<std::size_t>(count);
  const std::size_t listed = recording.frames.size();
  if (stored == 0)
    return fail("{}: holds no complete frame; record or copy it again", recording.video.string());
  if (stored < listed) {
    recording.frames.resize(stored);
    recording.notices.push_back(fmt::format("{}: cut off after frame {}, {} of {} frames",
                                            recording.video.string(),
                                            recording.frames.back().number, stored, listed));
  } else if (stored > listed) {
    recording.notices.push_back(
        fmt::format("{}: holds {} frames, but timestamps.csv lists {}; the rest is left out",
                    recording.video.string(), stored, listed));
  }
  return {};
}

// The camera's path by EuRoC's ground truth, which is of the body.
Result<Trajectory> load_euroc_groundtruth(const std::filesystem::path& mav0) {
  const std::filesystem::path folder = mav0 / "state_groundtruth_estimate0";
  auto truth = load_trajectory(folder / "data.csv");
  if (!truth) return truth;
  PENUMBRA_TRY(const auto T_body_camera, load_euroc_mounting(mav0 / "cam0" / "sensor.yaml"));
  // EuRoC's ground truth is of the body itself, unless its sensor.yaml has another T_BS.
  Transform<frame::Body, frame::Sensor> T_body_truth;
  if (is_there(folder / "sensor.yaml")) {
    PENUMBRA_TRY(const auto mounting, load_euroc_mounting(folder / "sensor.yaml"));
    T_body_truth = mounting;
  }
  const auto T_truth_camera = T_body_truth.inverse() * T_body_camera;
  for (StampedPose& pose : truth->poses) {
    const CameraPose& world_truth = pose.T_table_camera;
    pose.T_table_camera = {
        world_truth.rotation() * T_truth_camera.rotation(),
        world_truth.rotation() * T_truth_camera.translation() + world_truth.translation()};
  }
  truth->of_body = false;
  return truth;
}

// A recording without a ground truth that can be read is replayed all the same.
void add_euroc_groundtruth(const std::filesystem::path& mav0, Recording& recording) {
  const std::filesystem::path file = mav0 / "state_groundtruth_estimate0" / "data.csv";
  if (!is_there(file)) return;
  auto truth = load_euroc_groundtruth(mav0);
  if (!truth) {
    recording.notices.push_back(
        fmt::format("{}; the ground truth is not read", truth.error().message));
    return;
  }
  recording.notices.push_back(fmt::format(
      "{}: its world is taken as the table's frame; tags.yaml must be in it", file.string()));
  recording.groundtruth = std::move(*truth);
}

Result<void> load_surroundings(const std::filesystem::path& folder,
                               const std::filesystem::path& sensor,
                               const OpenRecordingOptions& options, Recording& recording) {
  if (!options.surroundings) return {};
  const std::filesystem::path camera = options.camera.value_or(folder / "camera.yaml");
  if (options.camera || is_there(camera)) {
    PENUMBRA_TRY(auto loaded, load_camera_file(camera, options.camera_name));
    for (std::string& warning : loaded.warnings) recording.notices.push_back(std::move(warning));
    recording.camera = std::move(loaded.camera);
    recording.camera_file = camera;
  } else if (!sensor.empty() && is_there(sensor)) {
    if (!options.camera_name.empty())
      return fail("{}: holds one camera; leave out --camera-name", sensor.string());
    PENUMBRA_TRY(auto loaded, load_euroc_sensor(sensor));
    if (const auto text = implausible_parameter(loaded))
      recording.notices.push_back(fmt::format("{}: {}", sensor.string(), *text));
    recording.camera = std::move(loaded);
    recording.camera_file = sensor;
  } else if (options.require_camera) {
    return fail("{}: no such file; put the camera's calibration there", camera.string());
  }

  const std::filesystem::path tags = options.tags.value_or(folder / "tags.yaml");
  if (options.tags || is_there(tags)) {
    PENUMBRA_TRY(auto map, load_tag_map(tags));
    recording.tags = std::move(map);
  } else if (options.require_tags) {
    return fail("{}: no such file; {}", tags.string(), kNameATagMap);
  }

  const std::filesystem::path truth = folder / "groundtruth.tum";
  if (is_there(truth)) {
    PENUMBRA_TRY(auto trajectory, load_trajectory(truth));
    recording.groundtruth = std::move(trajectory);
  } else if (!sensor.empty()) {
    add_euroc_groundtruth(sensor.parent_path().parent_path(), recording);
  }
  if (!recording.tags) return {};
  PENUMBRA_TRY(auto paths, load_group_paths(folder / "groups", other_groups(*recording.tags)));
  recording.group_groundtruth = std::move(paths);
  return {};
}

}  // namespace

std::optional<std::filesystem::path> group_file(const std::string& group) {
  constexpr std::size_t kLongest = 200;
  const bool plain = std::ranges::all_of(group, [](char c) {
    return static_cast<unsigned char>(c) >= 0x20 && c != '/' && c != '\\' && c != 0x7f;
  });
  if (!plain || group.empty() || group.size() > kLongest || group.front() == '.') {
    return std::nullopt;
  }
  return std::filesystem::path(group + ".tum");
}

Result<std::map<std::string, Trajectory>> load_group_paths(const std::filesystem::path& folder,
                                                           const std::vector<std::string>& groups) {
  std::map<std::string, Trajectory> paths;
  for (const std::string& group : groups) {
    const auto file = group_file(group);
    if (!file || !is_there(folder / *file)) continue;
    PENUMBRA_TRY(auto trajectory, load_trajectory(folder / *file));
    paths.emplace(group, std::move(trajectory));
  }
  return paths;
}

bool is_recording(const std::filesystem::path& folder) {
  const bool own = is_there(folder / "timestamps.csv") ||
                   (is_folder(folder / "frames") &&
                    (is_there(folder / "camera.yaml") || is_there(folder / "tags.yaml")));
  return own || is_there(folder / "mav0" / "cam0" / "data.csv") ||
         (is_there(folder / "data.csv") && is_folder(folder / "data"));
}

Result<Recording> open_recording(const std::filesystem::path& folder,
                                 const OpenRecordingOptions& options) {
  if (!is_there(folder)) return fail("{}: no such recording", folder.string());
  if (!is_folder(folder)) {
    return fail("{}: is not a folder; a recording is a folder with frames/ or video.mkv",
                folder.string());
  }
  PENUMBRA_TRY_VOID(check_readable(folder));
  Recording recording;
  recording.folder = folder;
  recording.name = name_of(folder);

  const std::filesystem::path cam0 = folder / "mav0" / "cam0";
  const bool euroc = is_there(cam0 / "data.csv") && !is_there(folder / "timestamps.csv");
  Result<void> listed;
  if (euroc) {
    listed = list_euroc(cam0, recording);
  } else {
    if (!is_folder(folder / "frames")) {
      if (!is_there(folder / "video.mkv")) {
        return fail(
            "{}: holds neither frames/ nor video.mkv (nor mav0/cam0/data.csv); is it a "
            "recording?",
            folder.string());
      }
      recording.video = folder / "video.mkv";
    } else if (auto readable = check_readable(folder / "frames"); !readable) {
      return tl::unexpected(readable.error());
    } else if (is_there(folder / "video.mkv")) {
      recording.notices.push_back(
          fmt::format("{}: has frames/ too, which are read; the video is left out",
                      (folder / "video.mkv").string()));
    }
    listed = list_own(folder, recording);
  }
  if (!listed) return tl::unexpected(listed.error());
  recording.of_camera = is_there(folder / "controls.json");
  // Before the frames are looked at: a recording without its camera says just that.
  if (auto loaded =
          load_surroundings(folder, euroc ? cam0 / "sensor.yaml" : "", options, recording);
      !loaded) {
    return tl::unexpected(loaded.error());
  }
  PENUMBRA_TRY_VOID(recording.video.empty() ? settle_pictures(recording) : settle_video(recording));
  if (recording.video.empty()) {
    std::vector<std::filesystem::path> pictures;
    for (const RecordedFrame& frame : recording.frames) pictures.push_back(frame.file);
    const SampleDepth depth = sample_depth_of(pictures);
    recording.sample_bits = depth.bits;
    if (depth.reduced()) {
      recording.notices.push_back(fmt::format("{}: {}", folder.string(), depth.text()));
    }
  }
  return recording;
}

double median_frame_interval_s(const Recording& recording) {
  std::vector<std::int64_t> gaps;
  for (std::size_t i = 1; i < recording.frames.size(); ++i) {
    gaps.push_back(recording.frames[i].timestamp_ns - recording.frames[i - 1].timestamp_ns);
  }
  if (gaps.empty()) return 1.0 / 30.0;
  const auto middle = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::nth_element(gaps.begin(), middle, gaps.end());
  return std::clamp(seconds(*middle), 1e-4, 10.0);
}

}  // namespace penumbra
