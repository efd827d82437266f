// Opens a recording: reads its listing, camera, tags and ground truth.
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <functional>
#include <iterator>
#include <system_error>

#include "app/recording/compressed_video.hpp"
#include "app/recording/recording_source.hpp"
#include "app/recording/video_reader.hpp"
#include "app/run_inputs.hpp"
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
constexpr std::int64_t kMaxFrameNumber = 999'999'999;  // nine digits in an image's name
constexpr double kMaxExposure_s = 60.0;
constexpr std::int64_t kMaxTimeNs = 4'000'000'000'000'000'000;  // differences fit into 64 bits

bool file_exists(const std::filesystem::path& path) {
  std::error_code ignored;
  return std::filesystem::exists(path, ignored);
}

bool is_folder(const std::filesystem::path& path) {
  std::error_code ignored;
  return std::filesystem::is_directory(path, ignored);
}

// Returns true if the file does not exist; false if that can't be determined.
bool is_missing(const std::filesystem::path& path) {
  std::error_code ignored;
  return std::filesystem::status(path, ignored).type() == std::filesystem::file_type::not_found;
}

Result<void> check_readable(const std::filesystem::path& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  const bool folder = std::filesystem::is_directory(status);
  if (status.type() != std::filesystem::file_type::none) {
    error.clear();
    if (access(path.c_str(), folder ? R_OK | X_OK : R_OK) != 0) {
      error.assign(errno, std::generic_category());
    }
  }
  if (!error) return {};
  return fail("{}: cannot be read: {}; check its permissions", path.string(), error.message());
}

std::string name_of(const std::filesystem::path& folder) {
  std::error_code error;
  const std::filesystem::path full = std::filesystem::canonical(folder, error);
  return error || full.filename().empty() ? folder.string() : full.filename().string();
}

// Quotes the beginning of a damaged line.
std::string quoted(std::string_view text) {
  std::string out;
  for (const char c : text.substr(0, 40)) out.push_back(c >= ' ' && c <= '~' ? c : '?');
  if (text.size() > 40) out += "...";
  return out;
}

struct Row {
  int line = 0;
  bool ended = true;  // has a line break; the last line of a truncated file lacks it
  std::vector<std::string_view> fields;
};

// Splits comma-separated rows and omits empty lines and comments. EuRoC's header is the first
// comment that contains "timestamp".
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
    for (const std::string_view field : split(body, ',')) row.fields.push_back(trim(field));
    rows.push_back(std::move(row));
  }
  return rows;
}

// Returns true if an image's path in a listing stays inside the recording.
bool stays_inside(std::string_view name) {
  const std::filesystem::path path = name;
  return !name.empty() && name.find('\0') == std::string_view::npos && path.is_relative() &&
         std::ranges::find(path, "..") == path.end();
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
      // After a crash a listing may end in the middle of a line.
      if (i + 1 == rows.size() && !row.ended && !recording.frames.empty()) {
        recording.notices.push_back(
            fmt::format("{}: line {} is cut off and skipped", csv, row.line));
        return {};
      }
      return tl::unexpected(frame.error());
    }
    recording.frames.push_back(std::move(*frame));
  }
  if (!recording.frames.empty()) return {};
  return fail("{}: lists 0 frames; record again, or list the frames there are", csv);
}

Result<void> list_timestamps_csv(const std::filesystem::path& folder, Recording& recording) {
  const std::filesystem::path csv_file = folder / "timestamps.csv";
  const std::string csv = csv_file.string();
  if (!file_exists(csv_file)) {
    return fail("{}: no such file; a recording needs it, with the lines frame,timestamp_s,file",
                csv);
  }
  PENUMBRA_TRY(const auto text, read_text_file(csv_file, kMaxListBytes));
  const std::vector<Row> rows = split_rows(text);
  if (rows.empty()) {
    return fail("{}: is empty; its first line must be frame,timestamp_s,file", csv);
  }
  const auto& header = rows.front().fields;
  const auto column = [&](std::string_view name) -> std::optional<std::size_t> {
    const auto found = std::ranges::find(header, name);
    if (found == header.end()) return std::nullopt;
    return static_cast<std::size_t>(found - header.begin());
  };
  const auto number_column = column("frame");
  const auto time_column = column("timestamp_s");
  const auto file_column = column("file");
  const auto exposure_column = column("exposure_s");
  const auto utc_column = column("wall_time_ns");
  const bool images = recording.video.empty();
  if (!number_column || !time_column || (images && !file_column)) {
    return fail("{}: line {}: has no column {}; the first line must be frame,timestamp_s,file", csv,
                rows.front().line,
                !number_column ? "frame"
                : !time_column ? "timestamp_s"
                               : "file");
  }
  for (const std::string_view name : header) {
    if (name.starts_with("exposure") && name != "exposure_s") {
      recording.notices.push_back(
          fmt::format("{}: column {}: is not read; exposures are read from exposure_s, in seconds",
                      csv, quoted(name)));
    } else if (name.starts_with("wall_time") && name != "wall_time_ns") {
      recording.notices.push_back(fmt::format(
          "{}: column {}: is not read; wall-clock times are read from wall_time_ns, in nanoseconds",
          csv, quoted(name)));
    }
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
      return fail("{}: line {}: frame: '{}' is not a frame number (0, 1, 2, ...)", csv, row.line,
                  quoted(number));
    }
    frame.number = static_cast<int>(*parsed_number);
    const std::string_view time = row.fields[*time_column];
    const auto parsed_time = parse_seconds_as_ns(time);
    if (!parsed_time) {
      return fail("{}: line {}: timestamp_s: '{}' is not a finite number of seconds", csv, row.line,
                  quoted(time));
    }
    frame.timestamp_ns = *parsed_time;
    if (exposure_column && !row.fields[*exposure_column].empty()) {
      const std::string_view exposure = row.fields[*exposure_column];
      frame.exposure_s = parse_number(exposure);
      if (!frame.exposure_s || !(*frame.exposure_s > 0.0 && *frame.exposure_s <= kMaxExposure_s)) {
        return fail("{}: line {}: exposure_s: '{}' is not a time above 0 and up to {} s", csv,
                    row.line, quoted(exposure), kMaxExposure_s);
      }
    }
    // The digits of a field without a line break after it may be cut off.
    const bool complete = row.ended || utc_column != row.fields.size() - 1;
    if (utc_column && complete && !row.fields[*utc_column].empty()) {
      const std::string_view utc = row.fields[*utc_column];
      frame.utc_ns = parse_integer(utc);
      if (!frame.utc_ns) {
        return fail(
            "{}: line {}: wall_time_ns: '{}' is not a whole number of nanoseconds since 1970 (UTC, "
            "up to the year 2262); correct it or leave it empty",
            csv, row.line, quoted(utc));
      }
    }
    if (images) {
      const std::string_view file = row.fields[*file_column];
      if (!stays_inside(file)) {
        return fail("{}: line {}: file: '{}' is not a path inside the recording", csv, row.line,
                    quoted(file));
      }
      frame.file = folder / file;
    }
    return frame;
  };
  return read_rows(rows, csv, read, recording);
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
      return fail("{}: line {}: timestamp: '{}' is not a whole number of nanoseconds", csv,
                  row.line, quoted(row.fields[0]));
    }
    frame.timestamp_ns = *time;
    const std::string_view file = row.fields[1];
    if (!stays_inside(file)) {
      return fail("{}: line {}: filename: '{}' is not a path inside the recording", csv, row.line,
                  quoted(file));
    }
    frame.file = cam0 / "data" / file;
    return frame;
  };
  return read_rows(rows, csv, read, recording);
}

// Drops missing or incomplete frames at the end, which a crash or a full disk leaves. Fails if an
// earlier frame is missing.
Result<void> drop_incomplete_images(Recording& recording) {
  const std::size_t listed = recording.frames.size();
  std::string first_cause;  // error of the first dropped frame
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
    } else if (const auto image = load_image(file); !image) {
      first_cause = image.error().message;
    } else {
      break;
    }
    recording.frames.pop_back();
  }
  if (recording.frames.empty()) {
    return fail("{}; none of the {} listed frames can be decoded", first_cause, listed);
  }
  for (const RecordedFrame& frame : recording.frames) {
    if (is_missing(frame.file)) {
      return fail(
          "{}: is listed but missing, and later frames exist; restore it, or remove its line from "
          "the listing",
          frame.file.string());
    }
    PENUMBRA_TRY_VOID(check_readable(frame.file));
  }
  if (recording.frames.size() < listed) {
    recording.notices.push_back(
        fmt::format("{}: cut off after frame {}, {} of {} frames ({})", recording.folder.string(),
                    recording.frames.back().number, recording.frames.size(), listed, first_cause));
  }
  return {};
}

Result<void> compare_video_length(Recording& recording) {
  PENUMBRA_TRY(const int count, count_video_frames(recording.video));
  const auto stored = static_cast<std::size_t>(count);
  const std::size_t listed = recording.frames.size();
  if (stored == 0) {
    return fail("{}: holds no complete frame; record or copy it again", recording.video.string());
  }
  if (stored < listed) {
    recording.frames.resize(stored);
    recording.notices.push_back(fmt::format("{}: cut off after frame {}, {} of {} frames",
                                            recording.video.string(),
                                            recording.frames.back().number, stored, listed));
  } else if (stored > listed) {
    recording.notices.push_back(
        fmt::format("{}: holds {} frames, but timestamps.csv lists {}; the rest is skipped",
                    recording.video.string(), stored, listed));
  }
  return {};
}

// Converts EuRoC's ground truth of the body to the camera's path.
Result<Trajectory> load_euroc_groundtruth(const std::filesystem::path& mav0) {
  const std::filesystem::path folder = mav0 / "state_groundtruth_estimate0";
  PENUMBRA_TRY(auto truth, load_trajectory(folder / "data.csv"));
  PENUMBRA_TRY(const auto T_body_camera, load_euroc_mounting(mav0 / "cam0" / "sensor.yaml"));
  // The identity, unless the ground truth's sensor.yaml contains another T_BS.
  Transform<frame::Body, frame::Sensor> T_body_truth;
  if (file_exists(folder / "sensor.yaml")) {
    PENUMBRA_TRY(T_body_truth, load_euroc_mounting(folder / "sensor.yaml"));
  }
  const auto T_truth_camera = T_body_truth.inverse() * T_body_camera;
  for (StampedPose& pose : truth.poses) {
    const CameraPose& world_truth = pose.T_table_camera;
    pose.T_table_camera = {
        world_truth.rotation() * T_truth_camera.rotation(),
        world_truth.rotation() * T_truth_camera.translation() + world_truth.translation()};
  }
  truth.of_body = false;
  return truth;
}

// Adds EuRoC's ground truth, or only a notice if it is unreadable.
void add_euroc_groundtruth(const std::filesystem::path& mav0, Recording& recording) {
  const std::filesystem::path file = mav0 / "state_groundtruth_estimate0" / "data.csv";
  if (!file_exists(file)) return;
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

// Loads the camera and the tags of a video file, which are always given by options.
Result<void> load_metadata_of_video(const OpenRecordingOptions& options, Recording& recording) {
  if (!options.with_metadata) return {};
  const std::string name = recording.folder.string();
  if (options.camera) {
    PENUMBRA_TRY(auto loaded, load_camera_file(*options.camera, options.camera_name));
    std::ranges::move(loaded.warnings, std::back_inserter(recording.notices));
    recording.camera = std::move(loaded.camera);
    recording.camera_file = *options.camera;
  } else if (options.require_camera) {
    return fail(
        "{}: a video has no camera file; name one (--calibration; map and evaluate: --camera)",
        name);
  }
  if (options.tags) {
    PENUMBRA_TRY(recording.tags, load_tag_map(*options.tags));
  } else if (options.require_tags) {
    return fail("{}: a video has no tag map; give one (--tags)", name);
  }
  return {};
}

Result<void> list_video_file(Recording& recording) {
  recording.video = recording.folder;
  PENUMBRA_TRY(auto listing, CompressedVideo::list(recording.video));
  std::ranges::move(listing.notices, std::back_inserter(recording.notices));
  recording.video_offset_ns = listing.offset_ns;
  for (const std::int64_t time_ns : listing.times_ns) {
    RecordedFrame& frame = recording.frames.emplace_back();
    frame.number = static_cast<int>(recording.frames.size()) - 1;
    frame.timestamp_ns = time_ns;
  }
  return {};
}

Result<void> load_metadata(const std::filesystem::path& folder, const std::filesystem::path& sensor,
                           const OpenRecordingOptions& options, Recording& recording) {
  if (!options.with_metadata) return {};
  const std::filesystem::path camera = options.camera.value_or(folder / "camera.yaml");
  if (options.camera || file_exists(camera)) {
    PENUMBRA_TRY(auto loaded, load_camera_file(camera, options.camera_name));
    std::ranges::move(loaded.warnings, std::back_inserter(recording.notices));
    recording.camera = std::move(loaded.camera);
    recording.camera_file = camera;
  } else if (!sensor.empty() && file_exists(sensor)) {
    if (!options.camera_name.empty()) {
      return fail("{}: holds one camera; leave out --camera-name", sensor.string());
    }
    PENUMBRA_TRY(recording.camera, load_euroc_sensor(sensor));
    if (const auto text = implausible_parameter(*recording.camera)) {
      recording.notices.push_back(fmt::format("{}: {}", sensor.string(), *text));
    }
    recording.camera_file = sensor;
  } else if (options.require_camera) {
    return fail("{}: no such file; put the camera's calibration there", camera.string());
  }

  const std::filesystem::path tags = options.tags.value_or(folder / "tags.yaml");
  if (options.tags || file_exists(tags)) {
    PENUMBRA_TRY(recording.tags, load_tag_map(tags));
  } else if (options.require_tags) {
    return fail("{}: no such file; {}", tags.string(), kTagMapRemedy);
  }

  const std::filesystem::path truth = folder / "groundtruth.tum";
  if (file_exists(truth)) {
    PENUMBRA_TRY(recording.groundtruth, load_trajectory(truth));
  } else if (!sensor.empty()) {
    add_euroc_groundtruth(sensor.parent_path().parent_path(), recording);
  }
  if (!recording.tags) return {};
  PENUMBRA_TRY(recording.group_groundtruth,
               load_group_paths(folder / "groups", other_groups(*recording.tags)));
  return {};
}

}  // namespace

std::optional<std::filesystem::path> group_file(const std::string& group) {
  constexpr std::size_t kMaxLength = 200;
  const bool plain = std::ranges::all_of(group, [](char c) {
    return static_cast<unsigned char>(c) >= 0x20 && c != '/' && c != '\\' && c != 0x7f;
  });
  if (!plain || group.empty() || group.size() > kMaxLength || group.front() == '.') {
    return std::nullopt;
  }
  return std::filesystem::path(group + ".tum");
}

Result<std::map<std::string, Trajectory>> load_group_paths(const std::filesystem::path& folder,
                                                           const std::vector<std::string>& groups) {
  std::map<std::string, Trajectory> paths;
  for (const std::string& group : groups) {
    const auto file = group_file(group);
    if (!file || !file_exists(folder / *file)) continue;
    PENUMBRA_TRY(auto trajectory, load_trajectory(folder / *file));
    paths.emplace(group, std::move(trajectory));
  }
  return paths;
}

bool is_recording(const std::filesystem::path& folder) {
  const bool native = file_exists(folder / "timestamps.csv") ||
                      (is_folder(folder / "frames") &&
                       (file_exists(folder / "camera.yaml") || file_exists(folder / "tags.yaml")));
  return native || file_exists(folder / "mav0" / "cam0" / "data.csv") ||
         (file_exists(folder / "data.csv") && is_folder(folder / "data"));
}

Result<Recording> open_recording(const std::filesystem::path& folder,
                                 const OpenRecordingOptions& options) {
  if (!file_exists(folder)) return fail("{}: no such recording", folder.string());
  PENUMBRA_TRY_VOID(check_readable(folder));
  Recording recording;
  recording.folder = folder;
  recording.name = name_of(folder);
  if (!is_folder(folder)) {
    PENUMBRA_TRY_VOID(list_video_file(recording));
    PENUMBRA_TRY_VOID(load_metadata_of_video(options, recording));
    return recording;
  }

  const std::filesystem::path cam0 = folder / "mav0" / "cam0";
  const bool euroc = file_exists(cam0 / "data.csv") && !file_exists(folder / "timestamps.csv");
  if (euroc) {
    PENUMBRA_TRY_VOID(list_euroc(cam0, recording));
  } else {
    if (!is_folder(folder / "frames")) {
      if (!file_exists(folder / "video.mkv")) {
        return fail(
            "{}: holds neither frames/ nor video.mkv (nor mav0/cam0/data.csv); is it a "
            "recording?",
            folder.string());
      }
      recording.video = folder / "video.mkv";
    } else {
      PENUMBRA_TRY_VOID(check_readable(folder / "frames"));
      if (file_exists(folder / "video.mkv")) {
        recording.notices.push_back(
            fmt::format("{}: has frames/ too; frames/ is read and the video ignored",
                        (folder / "video.mkv").string()));
      }
    }
    PENUMBRA_TRY_VOID(list_timestamps_csv(folder, recording));
  }
  recording.from_camera = file_exists(folder / "controls.json");
  // Loaded before the frames are checked, so that a missing camera file is the first error.
  PENUMBRA_TRY_VOID(load_metadata(folder, euroc ? cam0 / "sensor.yaml" : "", options, recording));
  PENUMBRA_TRY_VOID(recording.video.empty() ? drop_incomplete_images(recording)
                                            : compare_video_length(recording));
  if (recording.video.empty()) {
    std::vector<std::filesystem::path> images;
    for (const RecordedFrame& frame : recording.frames) images.push_back(frame.file);
    const SampleDepth depth = sample_depth_of(images);
    recording.sample_bits = depth.bits;
    if (depth.reduced()) {
      recording.notices.push_back(fmt::format("{}: {}", folder.string(), depth.text()));
    }
  }
  return recording;
}

std::optional<FrameRange> parse_frame_range(std::string_view text) {
  const std::size_t colon = text.find(':');
  if (colon == std::string_view::npos) return std::nullopt;
  const std::string_view first = text.substr(0, colon);
  const std::string_view last = text.substr(colon + 1);
  const auto number = [](std::string_view part) -> std::optional<int> {
    int value = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    if (error != std::errc() || end != part.data() + part.size() || value < 0) return std::nullopt;
    return value;
  };
  const auto begin = first.empty() ? 0 : number(first);
  const auto end = number(last);
  if (!begin || (!last.empty() && (!end || *end <= *begin))) return std::nullopt;
  return FrameRange{*begin, end};
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
