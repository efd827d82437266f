// Pictures to calibrate from, one after the other: a recording's, or those of a folder.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct Picture {
  std::string name;  // the file's, or "frame 12" of a video
  int index = 0;
  int count = 0;           // of all pictures, where known; else 0
  Frame frame;             // as it was decoded; empty where it can't be read
  ImageView luma;          // of it, empty where it can't be read ...
  std::string unreadable;  // ... and why
  // Warning about how images are read. Each one is set on one image only.
  std::string notice;
};

// Calls `take` for every picture, in order; ends early where it returns false or an error. A
// camera.yaml, tags.yaml or groundtruth.tum in the folder is not looked at. Fails, naming the
// folder, where there is nothing to read.
[[nodiscard]] Result<void> for_each_picture(
    const std::filesystem::path& source, const std::function<Result<bool>(const Picture&)>& take);

}  // namespace penumbra
