// A recording on disk: what it holds, and its frames in order.
//
//   camera.yaml tags.yaml frames/000000.jpg ... (or video.mkv) timestamps.csv groundtruth.tum?
//   groups/NAME.tum? ...   where the groups of tags beside the table truly are
//   (timestamps.csv: frame,timestamp_s,file, and exposure_s where it is known)
//   poses.tum? group-poses/NAME.tum? ...   camera and groups as they were tracked live
//
// EuRoC/ASL folders open too: mav0/cam0/data.csv (timestamp [ns], filename), mav0/cam0/data/*.png,
// mav0/cam0/sensor.yaml, mav0/state_groundtruth_estimate0/data.csv, and camera.yaml / tags.yaml /
// groundtruth.tum beside mav0 where given.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "app/capture/frame_source.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/trajectory.hpp"

namespace penumbra {

struct RecordedFrame {
  int number = 0;  // as listed
  std::int64_t timestamp_ns = 0;
  std::optional<double> exposure_s;  // as Frame's
  std::filesystem::path file;        // empty when the frames are in a video
};

// The listing of a recording: everything but the pixels.
struct Recording {
  std::filesystem::path folder;
  std::string name;
  std::vector<RecordedFrame> frames;  // in order of time
  std::filesystem::path video;        // video.mkv, or empty
  int sample_bits = 16;               // of 16-bit pictures, as DecodeOptions'
  // What a camera gave, whole or not: by the controls.json that only such a recording has.
  bool of_camera = false;
  std::optional<CameraModel> camera;  // absent only where allowed (stills to calibrate from)
  std::filesystem::path camera_file;  // that `camera` was read from
  std::optional<TagMap> tags;
  std::optional<Trajectory> groundtruth;
  // Of groups of tags beside the table, by their names: T_table_group.
  std::map<std::string, Trajectory> group_groundtruth;
  std::vector<std::string> notices;  // e.g. "cut off after frame 83 of 120"
};

struct OpenRecordingOptions {
  bool require_camera = true;
  bool require_tags = true;
  // Whether camera, tags and ground truth are read at all: calibration looks at pixels only.
  bool surroundings = true;
  std::string camera_name;                      // of a camera file with several cameras
  std::optional<std::filesystem::path> camera;  // instead of the recording's
  std::optional<std::filesystem::path> tags;    // instead of the recording's
};

// NAME.tum, the file of a group of tags in a folder of them; nothing where the name can be no
// file's ('/', "..", too long).
[[nodiscard]] std::optional<std::filesystem::path> group_file(const std::string& group);

// The paths (T_table_group) that a folder of such files has of these groups.
[[nodiscard]] Result<std::map<std::string, Trajectory>> load_group_paths(
    const std::filesystem::path& folder, const std::vector<std::string>& groups);
// The folder beside a file of camera poses that holds those of groups.
inline constexpr std::string_view kGroupPosesFolder = "group-poses";

// Whether the folder is a recording, or the camera's folder of an EuRoC one, by what lies in it.
[[nodiscard]] bool is_recording(const std::filesystem::path& folder);

// Errors name the file and what is wrong: no such folder, no camera.yaml, a bad line in
// timestamps.csv, 0 frames, a listed frame that is missing (except at the end: then the recording
// opens up to its last whole frame, with a notice).
[[nodiscard]] Result<Recording> open_recording(const std::filesystem::path& folder,
                                               const OpenRecordingOptions& options = {});

// Median time between frames, at least 0.1 ms [s].
[[nodiscard]] double median_frame_interval_s(const Recording& recording);

struct RecordingSourceOptions {
  int first = 0;  // frames [first, last) by position in the list
  std::optional<int> last;
  int look_ahead = 4;  // frames decoded ahead on a thread of its own; 0: decode when asked
};

// Frames as recorded: JPEG is decoded to its own YUV planes, PNG to grey or RGB, FFV1 to the stored
// planes; nothing is converted. `sequence` is the frame's number in the listing. Every frame must
// have the camera model's size; lines that an encoder padded a JPEG with do not count. An image
// that can't be decoded is an error, except in a camera's recording: there it is skipped as it was
// while recording, logged once and counted.
[[nodiscard]] Result<std::unique_ptr<FrameSource>> open_recording_source(
    const Recording& recording, const RecordingSourceOptions& options = {});

}  // namespace penumbra
