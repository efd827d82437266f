// A live session as a recording on disk.
//
// Files only grow, and a frame is written before the line that lists it: the recording opens after
// any crash, less at most the last frame. A thread writes; if the disk is too slow, frames are
// dropped and counted, and the live image continues.
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
#include "app/session/scene_edit.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"

namespace penumbra {

struct RecordingHead {
  std::string camera;  // for users: camera and stream
  StreamFormat format;
  std::vector<std::pair<std::string, std::int64_t>> controls;
  // Reads the controls again during the recording, on the writer's thread: some cameras report them
  // only with frames. An empty result keeps the last ones.
  std::function<std::vector<std::pair<std::string, std::int64_t>>()> read_controls;
  std::string camera_yaml;  // the text of the file
  std::string tags_yaml;
};

struct RecordingCounts {
  std::uint64_t written = 0;
  std::uint64_t dropped = 0;         // images that came too fast
  std::uint64_t lines_dropped = 0;   // poses, light, events after more than a minute of that
  std::optional<std::string> error;  // why writing ended early
};

class RecordingWriter {
 public:
  // Makes the folder, or fails and leaves nothing. Refuses a folder that is not empty.
  [[nodiscard]] static Result<std::unique_ptr<RecordingWriter>> create(
      const std::filesystem::path& folder, const RecordingHead& head);
  // The same without waiting for the disk: counts() and finish() report a failure.
  [[nodiscard]] static std::unique_ptr<RecordingWriter> begin(const std::filesystem::path& folder,
                                                              const RecordingHead& head);
  RecordingWriter(const RecordingWriter&) = delete;
  RecordingWriter& operator=(const RecordingWriter&) = delete;
  ~RecordingWriter();  // as finish()

  // None of these waits for the disk. By any thread. JPEGs are stored byte for byte, except for
  // repairs (normalized_jpeg()), other frames as FFV1 with a checksum per slice.
  void add_image(const CapturedImage& image);
  // Both keep only tracked poses.
  void add_pose(std::int64_t timestamp_ns, const PoseEstimate& pose);
  void add_group(std::int64_t timestamp_ns, const GroupEstimate& group);
  void add_event(std::int64_t timestamp_ns, std::string_view event, std::string_view detail = {});
  void add_scene_edit(const SceneEvent& event);
  void add_light(const LitFrame& lit);
  [[nodiscard]] const std::filesystem::path& folder() const;
  [[nodiscard]] RecordingCounts counts() const;

  // Writes everything added so far; nothing can be added after it.
  [[nodiscard]] Result<void> finish();

 private:
  struct Impl;
  RecordingWriter(std::unique_ptr<Impl> impl, bool opened);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
