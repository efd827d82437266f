// JPEG images of cameras and recordings. An image is used if it has the camera's size and every
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

struct CameraJpeg {
  std::span<const std::uint8_t> bytes;  // without bytes before and after the image
  std::optional<Frame> frame;           // decoded if the end mark is missing
};

// Remedies for incomplete images of a camera and for damaged files.
inline constexpr std::string_view kImproveTransfer =
    "data is lost between the camera and the computer: try another USB port or cable, no hub, or a "
    "lower --size or --fps";
inline constexpr std::string_view kRecordAgain = "record or copy it again";
// Format string; arguments: size of the image, size of the stream.
inline constexpr char kOtherJpegSize[] =
    "a JPEG of {}x{} px is skipped, as the stream is {}x{} px; choose another --size or --format";

// The image in a camera's buffer, or why it is not used. Decodes it only if the end mark is
// missing, to see whether it is complete. `remedy` ends the message about a damaged image.
[[nodiscard]] Started<CameraJpeg> receive_camera_jpeg(std::span<const std::uint8_t> bytes,
                                                      const ImageSize& granted,
                                                      std::string_view remedy = kImproveTransfer);

// Decodes a camera's image, without the padding of its encoder.
[[nodiscard]] Result<Frame> decode_camera_jpeg(std::span<const std::uint8_t> bytes,
                                               const std::string& name, const ImageSize& granted,
                                               std::string_view remedy);

// An image file of a recording: JPEG as above, and PNG. `size`: of the recording's camera.
[[nodiscard]] Result<Frame> decode_recorded_image(std::span<const std::uint8_t> bytes,
                                                  const std::string& name,
                                                  const std::optional<ImageSize>& size,
                                                  const DecodeOptions& options = {});

}  // namespace penumbra
