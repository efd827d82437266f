// JPEG images of cameras and recordings. An image is accepted if it has the stream's size
// (`granted`), apart from padding lines at the bottom, and all of its blocks can be decoded.
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
  std::optional<Frame> frame;  // set only if the end mark is missing (see receive_camera_jpeg())
};

// Remedies: kImproveTransfer for a camera's incomplete images, kRecordAgain for damaged files.
inline constexpr std::string_view kImproveTransfer =
    "data is lost between the camera and the computer: try another USB port or cable, no hub, or a "
    "lower --size or --fps";
inline constexpr std::string_view kRecordAgain = "record or copy it again";
// Format string. Arguments: width and height of the image, then of the stream.
inline constexpr char kWrongJpegSize[] =
    "a JPEG of {}x{} px is skipped, as the stream is {}x{} px; choose another --size or --format";

// Finds the image in a camera's buffer, or returns why it is rejected. Decodes it only if the end
// mark is missing, to check that it is complete. `remedy` ends the message about a damaged image.
[[nodiscard]] StreamResult<CameraJpeg> receive_camera_jpeg(
    std::span<const std::uint8_t> bytes, const ImageSize& granted,
    std::string_view remedy = kImproveTransfer);

// Decodes a camera's image and crops the padding that its encoder added.
[[nodiscard]] Result<Frame> decode_camera_jpeg(std::span<const std::uint8_t> bytes,
                                               const std::string& name, const ImageSize& granted,
                                               std::string_view remedy);

// Decodes a recording's JPEG or PNG file. Crops a JPEG's padding to `size`, the camera's size.
[[nodiscard]] Result<Frame> decode_recorded_image(std::span<const std::uint8_t> bytes,
                                                  const std::string& name,
                                                  const std::optional<ImageSize>& size,
                                                  const DecodeOptions& options = {});

}  // namespace penumbra
