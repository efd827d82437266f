// Makes a lossless recording of a video file.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "app/recording/recording_source.hpp"
#include "core/error.hpp"

namespace penumbra {

struct ImportRequest {
  std::filesystem::path video;
  std::filesystem::path output;                 // new or empty folder
  std::optional<std::filesystem::path> camera;  // becomes camera.yaml
  std::string camera_name;                      // selects one camera of a file with several
  std::optional<std::filesystem::path> tags;    // becomes tags.yaml
  FrameRange frames;
};

struct ImportSummary {
  int frames = 0;            // written
  std::int64_t damaged = 0;  // skipped
  bool interrupted = false;  // Ctrl-C: the recording ends with the last written frame
};

// Logs the notices of the video. The output folder appears when it is complete; an error leaves no
// files. Frames keep the numbers and times that they have in the video.
[[nodiscard]] Result<ImportSummary> import_video(const ImportRequest& request);

}  // namespace penumbra
