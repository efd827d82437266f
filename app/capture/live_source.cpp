#include "app/capture/live_source.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "app/capture/camera_jpeg.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kLowerTheLoad =
    "use a smaller --size or --fps, another USB port, or end other programs";

}  // namespace

std::string rate_text(const StreamFormat& format) {
  return fmt::format("{:.4g}/s{}", 1.0 / format.interval_s,
                     format.interval_granted ? "" : " as asked, or its own rate");
}

std::chrono::milliseconds bad_frame_pause(double interval_s) {
  return std::chrono::milliseconds(std::lround(std::clamp(500.0 * interval_s, 1.0, 100.0)));
}

void count_stamp(FaultCounter& faults, const FrameStamp& stamp, const StreamFormat& format) {
  if (stamp.lost_counted > 0) {
    faults.count(
        CaptureFault::gap,
        fmt::format("frames were dropped by the camera or its driver, which counts them; {}",
                    kLowerTheLoad),
        stamp.lost_counted);
  }
  if (stamp.lost_by_time > 0) {
    faults.count(
        CaptureFault::silent_gap,
        fmt::format("frames were dropped without the driver counting them: the time between two "
                    "frames was too long; {}",
                    kLowerTheLoad),
        stamp.lost_by_time);
  }
  if (stamp.bad_time) {
    faults.count(
        CaptureFault::bad_time,
        "the driver's timestamp of a frame is impossible; its time of arrival is used instead, "
        "which is less exact: if this recurs, update the kernel or use another camera");
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

std::string_view LiveSource::damage_remedy() const {
  return kImproveTransfer;
}

std::optional<Frame> LiveSource::decode(const CapturedImage& image) {
  Frame frame = image.frame;
  if (!image.is_jpeg()) {
    frame.owner = image.owner;
  } else if (frame.empty()) {
    const StreamFormat stream = format();
    const ImageSize granted{stream.width, stream.height};
    auto decoded = decode_camera_jpeg(image.jpeg, "a frame", granted, damage_remedy());
    if (!decoded) {
      faults().count_undecoded(decoded.error().message);
      return std::nullopt;
    }
    if (decoded->width != stream.width || decoded->height != stream.height) {
      faults().count_undecoded(fmt::format(kWrongJpegSize, decoded->width, decoded->height,
                                           stream.width, stream.height));
      return std::nullopt;
    }
    frame = std::move(*decoded);
  }
  frame.sequence = image.sequence;
  frame.timestamp_ns = image.timestamp_ns;
  frame.utc_ns = image.utc_ns;
  frame.exposure_s = image.exposure_s;
  return frame;
}

Result<std::optional<Frame>> LiveSource::next() {
  while (true) {
    PENUMBRA_TRY(auto image, next_image());
    if (!image) return std::optional<Frame>();
    const Stopwatch watch;
    if (auto frame = decode(*image)) {
      capture_time_ = watch.elapsed();
      return frame;
    }
  }
}

}  // namespace penumbra
