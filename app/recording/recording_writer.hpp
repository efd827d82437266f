// A live session on disk, as a recording: what the camera gave, unchanged, while it runs.
//
// Everything is only ever added to, a frame before the line that lists it: whenever the program or
// the disk ends, what is there opens, less at most the frame that was being written. Writing has a
// thread of its own; when the disk is too slow, frames are left out and counted, and the picture on
// the screen goes on.
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
  std::string camera;  // for people: which camera, at what
  StreamFormat format;
  std::vector<std::pair<std::string, std::int64_t>> controls;
  // Asked for them again while the recording goes on, by the writer's thread: some cameras say what
  // they are only with their frames. Nothing: they stay.
  std::function<std::vector<std::pair<std::string, std::int64_t>>()> read_controls;
  std::string camera_yaml;  // the text of the file
  std::string tags_yaml;
};

struct RecordingCounts {
  std::uint64_t written = 0;
  std::uint64_t dropped = 0;         // writing could not keep up
  std::uint64_t lines_dropped = 0;   // poses, light, events: for more than a minute it could not
  std::optional<std::string> error;  // why writing ended early
};

class RecordingWriter {
 public:
  // Makes the folder; one that holds anything already is refused. Where that fails, nothing stays
  // of what it made.
  [[nodiscard]] static Result<std::unique_ptr<RecordingWriter>> create(
      const std::filesystem::path& folder, const RecordingHead& head);
  // The same without a wait for the disk: that the folder can't be made is told by counts() and
  // finish(), as what goes wrong later.
  [[nodiscard]] static std::unique_ptr<RecordingWriter> begin(const std::filesystem::path& folder,
                                                              const RecordingHead& head);
  RecordingWriter(const RecordingWriter&) = delete;
  RecordingWriter& operator=(const RecordingWriter&) = delete;
  ~RecordingWriter();  // as finish()

  // None of these waits for the disk. JPEGs are stored byte for byte, but for what cameras
  // do to their marks and size (normalized_jpeg()), other frames lossless as FFV1 with a check sum
  // for each slice. By any thread.
  void add_image(const CapturedImage& image);
  // Tracked ones are kept.
  void add_pose(std::int64_t timestamp_ns, const PoseEstimate& pose);
  void add_group(std::int64_t timestamp_ns, const GroupEstimate& group);
  void add_event(std::int64_t timestamp_ns, std::string_view event, std::string_view detail = {});
  void add_scene_edit(const SceneEvent& event);
  void add_light(const LitFrame& lit);
  [[nodiscard]] const std::filesystem::path& folder() const;
  [[nodiscard]] RecordingCounts counts() const;

  // Everything added so far is written when this returns; nothing can be added after it.
  [[nodiscard]] Result<void> finish();

 private:
  struct Impl;
  RecordingWriter(std::unique_ptr<Impl> impl, bool opened);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
