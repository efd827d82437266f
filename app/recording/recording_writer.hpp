// Writes a live session to disk as a recording.
//
// Files are only appended to, and a frame is written before the line that lists it. After a crash
// the recording can therefore be opened; only its last frame may be missing. A thread writes the
// files. If the disk is too slow, frames are dropped and counted, and the live image continues.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/capture/live_source.hpp"
#include "app/recording/session_record.hpp"
#include "app/session/scene_edit.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"

namespace penumbra {

struct RecordingHead {
  std::string camera;  // camera and stream, for users
  StreamFormat format;
  std::vector<std::pair<std::string, std::int64_t>> controls;
  // Reads the controls again on the writer's thread, because some cameras report them only with
  // frames. An empty result does not replace the previous values.
  std::function<std::vector<std::pair<std::string, std::int64_t>>()> read_controls;
  std::string camera_yaml;  // text of camera.yaml
  std::string tags_yaml;
  SessionHead session;  // not kept if its scene is empty
};

struct RecordingCounts {
  std::uint64_t written = 0;
  std::uint64_t dropped = 0;         // images dropped: the disk was too slow, or writing had ended
  std::uint64_t lines_dropped = 0;   // poses, light, events; dropped if the queue is full
  std::optional<std::string> error;  // why writing ended early
};

class RecordingWriter {
 public:
  // Creates the folder. Fails if it exists and is not empty. Leaves no files if it fails.
  [[nodiscard]] static Result<std::unique_ptr<RecordingWriter>> create(
      const std::filesystem::path& folder, const RecordingHead& head);
  // Like create(), but does not wait for the disk: counts() and finish() report a failure.
  [[nodiscard]] static std::unique_ptr<RecordingWriter> begin(const std::filesystem::path& folder,
                                                              const RecordingHead& head);
  RecordingWriter(const RecordingWriter&) = delete;
  RecordingWriter& operator=(const RecordingWriter&) = delete;
  ~RecordingWriter();  // calls finish()

  // These functions do not wait for the disk and are thread-safe. JPEGs are stored byte for byte,
  // except for repairs (normalized_jpeg()); other frames as FFV1 with a checksum per slice.
  void add_image(const CapturedImage& image);
  // add_pose() and add_group() ignore poses that are not tracked.
  void add_pose(std::int64_t timestamp_ns, const PoseEstimate& pose);
  void add_group(std::int64_t timestamp_ns, const GroupEstimate& group);
  void add_event(std::int64_t timestamp_ns, std::string_view event, std::string_view detail = {});
  // Copies the files of an added model too.
  void add_scene_edit(const SceneEvent& event);
  void add_light(const LitFrame& lit);
  [[nodiscard]] const std::filesystem::path& folder() const;
  [[nodiscard]] RecordingCounts counts() const;

  // Writes all data added so far and ends the recording.
  [[nodiscard]] Result<void> finish();

 private:
  struct Impl;
  RecordingWriter(std::unique_ptr<Impl> impl, bool opened);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
