#include "app/capture/camera_jpeg.hpp"

#include <atomic>
#include <utility>

#include "app/logging.hpp"
#include "core/image/jpeg_file.hpp"
#include "core/image/jpeg_outline.hpp"

namespace penumbra {
namespace {

// Hardware encoders pad images to whole blocks of 16 lines, for example 1080 to 1088. The padding
// is at the bottom.
bool has_padding_lines(const ImageSize& image, const ImageSize& granted) {
  constexpr int kLargestBlock = 16;
  return image.width == granted.width && image.height > granted.height &&
         image.height - granted.height < kLargestBlock;
}

Frame without_padding(Frame frame, const ImageSize& size) {
  if (!has_padding_lines({frame.width, frame.height}, size)) return frame;
  static std::atomic<bool> is_reported = false;
  if (!is_reported.exchange(true)) {
    log_warning(
        "JPEGs have {} lines; the first {} are used, the others are their encoder's padding",
        frame.height, size.height);
  }
  frame.height = size.height;
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    const bool is_half = i > 0 && frame.format == PixelFormat::yuv420p;
    frame.planes[i].height = is_half ? (size.height + 1) / 2 : size.height;
  }
  return frame;
}

}  // namespace

StreamResult<CameraJpeg> receive_camera_jpeg(std::span<const std::uint8_t> bytes,
                                             const ImageSize& granted, std::string_view remedy) {
  const auto outline = outline_jpeg(bytes);
  if (!outline) {
    return fail_with(CaptureFault::damaged, "an incomplete JPEG is skipped ({}); {}",
                     outline.error().message, remedy);
  }
  const ImageSize size{outline->width, outline->height};
  if (size != granted && !has_padding_lines(size, granted)) {
    return fail_with(CaptureFault::wrong_format, kWrongJpegSize, size.width, size.height,
                     granted.width, granted.height);
  }
  CameraJpeg image{outline->bytes, std::nullopt};
  if (outline->has_end_mark) return image;
  auto frame = decode_camera_jpeg(outline->bytes, "a frame", granted, remedy);
  if (!frame) return fail_with(CaptureFault::damaged, "{}", frame.error().message);
  image.frame = std::move(*frame);
  return image;
}

Result<Frame> decode_camera_jpeg(std::span<const std::uint8_t> bytes, const std::string& name,
                                 const ImageSize& granted, std::string_view remedy) {
  auto frame = decode_jpeg(bytes, name, remedy);
  if (!frame) return frame;
  return without_padding(std::move(*frame), granted);
}

Result<Frame> decode_recorded_image(std::span<const std::uint8_t> bytes, const std::string& name,
                                    const std::optional<ImageSize>& size,
                                    const DecodeOptions& options) {
  auto frame = decode_image(bytes, name, options);
  if (!frame || !size || !is_jpeg(bytes)) return frame;
  return without_padding(std::move(*frame), *size);
}

}  // namespace penumbra
