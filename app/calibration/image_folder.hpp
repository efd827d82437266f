// Reads the images of a recording or a folder for a calibration.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct NamedImage {
  std::string name;  // file name, or "frame 12" of a video
  int index = 0;
  int count = 0;                             // number of images; 0 if unknown
  Frame frame;                               // decoded image; empty if unreadable
  std::optional<std::int64_t> timestamp_ns;  // if the source is a recording or a camera
  ImageView luma;                            // luma plane of `frame`
  std::string unreadable;                    // error message if the image can't be read
  std::vector<std::string> notices;          // warnings; each one is set for one image only
};

// Calls `visit` for every image in order until it returns false or an error. Ignores camera.yaml,
// tags.yaml and groundtruth.tum in the folder. Fails if there are no images.
[[nodiscard]] Result<void> for_each_image(
    const std::filesystem::path& source,
    const std::function<Result<bool>(const NamedImage&)>& visit);

}  // namespace penumbra
