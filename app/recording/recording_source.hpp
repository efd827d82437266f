// A recording on disk and its frames in order.
//
//   camera.yaml tags.yaml frames/000000.jpg ... (or video.mkv) timestamps.csv groundtruth.tum?
//   groups/NAME.tum? ...                   ground truth of the tag groups beside the table
//   (timestamps.csv: frame,timestamp_s,file, and exposure_s if known)
//   poses.tum? group-poses/NAME.tum? ...   camera and groups as tracked live
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
  int number = 0;  // as listed
  std::int64_t timestamp_ns = 0;
  std::optional<double> exposure_s;  // as Frame's
  std::filesystem::path file;        // empty when the frames are in a video
};

// A recording without its pixels.
struct Recording {
  std::filesystem::path folder;
  std::string name;
  std::vector<RecordedFrame> frames;  // in order of time
  std::filesystem::path video;        // video.mkv, or empty
  int sample_bits = 16;               // of 16-bit images, as DecodeOptions'
  bool of_camera = false;             // a live session (has controls.json); frames may be damaged
  std::optional<CameraModel> camera;  // empty only if allowed (stills to calibrate from)
  std::filesystem::path camera_file;  // of `camera`
  std::optional<TagMap> tags;
  std::optional<Trajectory> groundtruth;
  std::map<std::string, Trajectory> group_groundtruth;  // T_table_group by group name
  std::vector<std::string> notices;                     // e.g. "cut off after frame 83 of 120"
};

struct OpenRecordingOptions {
  bool require_camera = true;
  bool require_tags = true;
  bool surroundings = true;  // reads camera, tags and ground truth; calibration needs only pixels
  std::string camera_name;   // in a camera file with several cameras
  std::optional<std::filesystem::path> camera;  // instead of the recording's
  std::optional<std::filesystem::path> tags;    // instead of the recording's
};

// NAME.tum, the file of a tag group; empty if the name can't be a file name ('/', "..", too long).
[[nodiscard]] std::optional<std::filesystem::path> group_file(const std::string& group);

// The paths (T_table_group) of these groups in a folder of such files.
[[nodiscard]] Result<std::map<std::string, Trajectory>> load_group_paths(
    const std::filesystem::path& folder, const std::vector<std::string>& groups);
// The folder of group poses beside a file of camera poses.
inline constexpr std::string_view kGroupPosesFolder = "group-poses";

// Returns true if the folder is a recording or the camera's folder of an EuRoC one, by its files.
[[nodiscard]] bool is_recording(const std::filesystem::path& folder);

// Fails on a missing folder or camera.yaml, a bad line in timestamps.csv, 0 frames, or a missing
// frame; frames missing at the end are only a notice.
[[nodiscard]] Result<Recording> open_recording(const std::filesystem::path& folder,
                                               const OpenRecordingOptions& options = {});

// Median time between frames, at least 0.1 ms [s].
[[nodiscard]] double median_frame_interval_s(const Recording& recording);

// Frames [first, last).
struct FrameRange {
  int first = 0;
  std::optional<int> last;
};
// "A:B", "A:" or ":B"; empty if it is malformed or holds no frame.
[[nodiscard]] std::optional<FrameRange> parse_frame_range(std::string_view text);

struct RecordingSourceOptions : FrameRange {  // by position in the list
  int look_ahead = 4;                         // frames decoded ahead on a thread; 0: no thread
};

// Frames as recorded, without conversion: JPEG gives its YUV planes, PNG grey or RGB, FFV1 the
// stored planes. `sequence` is the frame's number in the listing. Every frame must have the camera
// model's size, without a JPEG's padding. An image that can't be decoded is an error; in a live
// session's recording it is skipped as in the session, logged once and counted.
[[nodiscard]] Result<std::unique_ptr<FrameSource>> open_recording_source(
    const Recording& recording, const RecordingSourceOptions& options = {});

}  // namespace penumbra
