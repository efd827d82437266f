// Reads images to calibrate from, of a recording or a folder.
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
  int count = 0;           // of all images, if known; else 0
  Frame frame;             // as decoded; empty if unreadable
  ImageView luma;          // of the frame
  std::string unreadable;  // the error, if unreadable
  std::string notice;      // warning about how images are read, on one image only
};

// Calls `take` for every image in order, until it returns false or an error. Reads no camera.yaml,
// tags.yaml or groundtruth.tum in the folder. Fails if there are no images.
[[nodiscard]] Result<void> for_each_picture(
    const std::filesystem::path& source, const std::function<Result<bool>(const Picture&)>& take);

}  // namespace penumbra
