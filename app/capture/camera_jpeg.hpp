// JPEG images as cameras send them. A camera's frames, a recording's, and a recording that stands
// for a camera are judged by the same rules: an image is used if it has the camera's size and every
// block of it was decoded.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "app/capture/camera_trouble.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_file.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

// Encoders in hardware pad images to whole blocks of 16 lines: 1088 for 1080. The first lines are
// the image.
[[nodiscard]] bool has_padding_lines(const ImageSize& image, const ImageSize& granted);

struct CameraJpeg {
  std::span<const std::uint8_t> bytes;  // without what stood before and after the image
  // Decoded already if the end mark is missing: only that shows whether the image is complete.
  std::optional<Frame> frame;
};

// The remedy where a camera's images arrive incomplete, and where a file's are damaged.
inline constexpr std::string_view kImproveTransfer =
    "data is lost between the camera and the computer: try another USB port or cable, no hub, or a "
    "lower --size or --fps";
inline constexpr std::string_view kRecordAgain = "record or copy it again";

// The image in a camera's buffer, or why it is not used. Decodes only where the end mark is
// missing. `remedy` ends the message about a damaged one.
[[nodiscard]] Started<CameraJpeg> receive_camera_jpeg(std::span<const std::uint8_t> bytes,
                                                      const ImageSize& granted,
                                                      std::string_view remedy = kImproveTransfer);

// Decodes an image of a camera. What its encoder padded it with is not part of the frame.
[[nodiscard]] Result<Frame> decode_camera_jpeg(std::span<const std::uint8_t> bytes,
                                               const std::string& name, const ImageSize& granted,
                                               std::string_view remedy);

// An image file of a recording: JPEG as above, and PNG. `size`: of the recording's camera.
// `options`: how PNG samples are read.
[[nodiscard]] Result<Frame> decode_recorded_image(std::span<const std::uint8_t> bytes,
                                                  const std::string& name,
                                                  const std::optional<ImageSize>& size,
                                                  const DecodeOptions& options = {});

}  // namespace penumbra
