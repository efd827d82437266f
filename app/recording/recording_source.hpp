// A recording on disk and its frames in order. Files marked with ? are optional.
//
//   camera.yaml tags.yaml frames/000000.jpg ... (or video.mkv) timestamps.csv groundtruth.tum?
//   groups/NAME.tum? ...                   ground truth of the tag groups beside the table
//   (timestamps.csv: frame,timestamp_s,file, and exposure_s and wall_time_ns if known)
//   poses.tum? group-poses/NAME.tum? ...   camera and group poses of the live session
//
// Or a video file (MP4, MOV, AVI, ...) in place of the folder: its frames, with the container's
// times.
//
// EuRoC/ASL folders: mav0/cam0/data.csv (timestamp [ns], filename), mav0/cam0/data/*.png,
// mav0/cam0/sensor.yaml, mav0/state_groundtruth_estimate0/data.csv, and optionally camera.yaml,
// tags.yaml, groundtruth.tum beside mav0.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "app/capture/frame_source.hpp"
#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/trajectory.hpp"

namespace penumbra {

struct RecordedFrame {
  int number = 0;  // number in the listing
  std::int64_t timestamp_ns = 0;
  std::optional<std::int64_t> utc_ns;  // see Frame::utc_ns
  std::optional<double> exposure_s;    // see Frame::exposure_s
  std::filesystem::path file;          // empty if the frames are in a video
};

// The description of a recording, without pixels.
struct Recording {
  std::filesystem::path folder;  // or the video file
  std::string name;
  std::vector<RecordedFrame> frames;  // in order of time
  std::filesystem::path video;        // video.mkv, the video file, or empty
  std::int64_t video_offset_ns = 0;   // VideoListing::offset_ns of a video file
  int sample_bits = 16;               // bits used in 16-bit images, see DecodeOptions
  bool from_camera = false;           // recorded live (has controls.json), so frames may be damaged
  std::optional<CameraModel> camera;  // nullopt only if not required (images for a calibration)
  std::filesystem::path camera_file;  // file of `camera`
  std::optional<TagMap> tags;
  std::optional<Trajectory> groundtruth;
  std::map<std::string, Trajectory> group_groundtruth;  // T_table_group by group name
  std::vector<std::string> notices;                     // e.g. "cut off after frame 83 of 120"

  // Returns true for a video file in place of a folder.
  [[nodiscard]] bool is_video_file() const { return !video.empty() && video == folder; }
};

struct OpenRecordingOptions {
  bool require_camera = true;
  bool require_tags = true;
  bool with_metadata = true;  // reads camera, tags and ground truth; off for a calibration
  std::string camera_name;    // selects one camera of a file with several
  std::optional<std::filesystem::path> camera;  // instead of the recording's
  std::optional<std::filesystem::path> tags;    // instead of the recording's
};

// Returns NAME.tum for a tag group; nullopt if the name can't be a file name ('/', "..", too long).
[[nodiscard]] std::optional<std::filesystem::path> group_file(const std::string& group);

// Loads the trajectories (T_table_group) of these groups from the group_file()s of a folder.
[[nodiscard]] Result<std::map<std::string, Trajectory>> load_group_paths(
    const std::filesystem::path& folder, const std::vector<std::string>& groups);
// Name of the folder of group poses beside a file of camera poses.
inline constexpr std::string_view kGroupPosesFolder = "group-poses";

// Returns true if the folder's files are those of a recording or of an EuRoC camera folder.
[[nodiscard]] bool is_recording(const std::filesystem::path& folder);

// Fails if the folder, camera.yaml or a frame is missing, if timestamps.csv has a bad line, or if
// there are no frames. Frames that are missing at the end cause only a notice.
[[nodiscard]] Result<Recording> open_recording(const std::filesystem::path& folder,
                                               const OpenRecordingOptions& options = {});

// Returns the median time between frames, clamped to 0.1 ms to 10 s [s]; 1/30 s for a single frame.
[[nodiscard]] double median_frame_interval_s(const Recording& recording);

// Frames [first, last).
struct FrameRange {
  int first = 0;
  std::optional<int> last;
};
// Parses "A:B", "A:" or ":B". Returns nullopt if the text is malformed or the range is empty.
[[nodiscard]] std::optional<FrameRange> parse_frame_range(std::string_view text);

struct RecordingSourceOptions : FrameRange {  // indices into Recording::frames
  int look_ahead = 4;                         // frames decoded ahead on a thread; 0: no thread
};

// Returns frames as recorded, without conversion: JPEG as YUV planes, PNG as grey or RGB, FFV1 as
// the stored planes. `sequence` is the frame's number in the listing. Every frame must have the
// camera model's size after JPEG padding is cropped. An image that can't be decoded is an error; in
// a live session's recording it is skipped like in the session, counted, and logged once.
[[nodiscard]] Result<std::unique_ptr<FrameSource>> open_recording_source(
    const Recording& recording, const RecordingSourceOptions& options = {});

}  // namespace penumbra
