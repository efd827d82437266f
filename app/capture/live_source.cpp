#include "app/capture/live_source.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/image_file.hpp"

namespace penumbra {
namespace {

// Of a JPEG stream (ITU-T T.81, annex B).
constexpr std::uint8_t kStartOfImage = 0xD8;
constexpr std::uint8_t kEndOfImage = 0xD9;
constexpr std::uint8_t kStartOfScan = 0xDA;

bool is_frame_header(std::uint8_t marker) {
  return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
}

}  // namespace

std::string rate_in_words(const StreamFormat& format) {
  return fmt::format("{:.4g}/s{}", 1.0 / format.interval_s,
                     format.interval_granted ? "" : " as asked, or its own rate");
}

std::chrono::milliseconds bad_frame_pause(double interval_s) {
  return std::chrono::milliseconds(std::lround(std::clamp(500.0 * interval_s, 1.0, 100.0)));
}

std::span<const std::uint8_t> trim_jpeg(std::span<const std::uint8_t> bytes) {
  std::size_t size = bytes.size();
  while (size > 0 && bytes[size - 1] == 0) --size;
  return bytes.first(size);
}

void count_stamp(FaultCounter& faults, const FrameStamp& stamp, const StreamFormat& format) {
  if (stamp.lost_counted > 0) {
    faults.count(CaptureFault::gap,
                 "frames were dropped by the camera or its driver, which counts them",
                 stamp.lost_counted);
  }
  if (stamp.lost_silent > 0) {
    faults.count(
        CaptureFault::silent_gap,
        "frames were dropped without the driver counting them: the time between two frames was too "
        "long",
        stamp.lost_silent);
  }
  if (stamp.bad_time) {
    faults.count(
        CaptureFault::bad_time,
        "the driver's timestamp of a frame is impossible; its time of arrival is used instead");
  }
  if (stamp.slower_interval_ns > 0) {
    faults.count(
        CaptureFault::slow_rate,
        fmt::format("{:.3g} frames/s come where {} {:.3g}; in dim light automatic exposure "
                    "slows a camera down: add light, set a shorter --exposure, or switch "
                    "its control exposure_dynamic_framerate off",
                    1e9 / static_cast<double>(stamp.slower_interval_ns),
                    format.interval_granted ? "the camera granted" : "the request was",
                    1.0 / format.interval_s));
  }
}

std::optional<JpegSize> jpeg_size(std::span<const std::uint8_t> bytes) {
  const std::size_t size = bytes.size();
  if (size < 4 || bytes[0] != 0xFF || bytes[1] != kStartOfImage) return std::nullopt;
  std::optional<JpegSize> found;
  // Segment after segment up to the first scan.
  std::size_t at = 2;
  while (at + 4 <= size && bytes[at] == 0xFF) {
    const std::uint8_t marker = bytes[at + 1];
    if (marker == 0xFF) {  // a fill byte
      ++at;
      continue;
    }
    const std::size_t length = (std::size_t{bytes[at + 2]} << 8U) | bytes[at + 3];
    if (length < 2 || at + 2 + length > size) return std::nullopt;
    if (marker == kStartOfScan) return found;
    if (is_frame_header(marker)) {
      if (length < 8) return std::nullopt;
      found = {(bytes[at + 7] << 8) | bytes[at + 8], (bytes[at + 5] << 8) | bytes[at + 6]};
    }
    at += 2 + length;
  }
  return std::nullopt;
}

bool is_whole_jpeg(std::span<const std::uint8_t> bytes, int width, int height) {
  const std::size_t size = bytes.size();
  if (size < 4 || bytes[size - 2] != 0xFF || bytes[size - 1] != kEndOfImage) return false;
  const auto found = jpeg_size(bytes);
  return found && found->width == width && found->height == height;
}

std::optional<Frame> LiveSource::decode(const CapturedImage& image) {
  Frame frame;
  if (image.is_jpeg()) {
    auto decoded = decode_image(image.jpeg, "a frame");
    if (!decoded) {
      faults().count_undecoded(decoded.error().message);
      return std::nullopt;
    }
    const StreamFormat stream = format();
    if (decoded->width != stream.width || decoded->height != stream.height) {
      faults().count_undecoded(fmt::format("a frame is {}x{} px, the others {}x{} px",
                                           decoded->width, decoded->height, stream.width,
                                           stream.height));
      return std::nullopt;
    }
    frame = std::move(*decoded);
  } else {
    frame = image.frame;
    frame.owner = image.owner;
  }
  frame.sequence = image.sequence;
  frame.timestamp_ns = image.timestamp_ns;
  frame.exposure_s = image.exposure_s;
  return frame;
}

Result<std::optional<Frame>> LiveSource::next() {
  while (true) {
    auto image = next_image();
    if (!image) return tl::unexpected(image.error());
    if (!*image) return std::optional<Frame>();
    const Stopwatch watch;
    auto frame = decode(**image);
    if (!frame) continue;
    capture_time_ = watch.elapsed();
    return frame;
  }
}

}  // namespace penumbra
