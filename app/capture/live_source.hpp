// A camera, or a recording played as one: a slow reader loses frames.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/capture/capture_stats.hpp"
#include "app/capture/frame_clock.hpp"
#include "app/capture/frame_source.hpp"

namespace penumbra {

struct CapturedImage {
  std::uint64_t sequence = 0;        // from 0; a gap is a lost frame
  std::int64_t timestamp_ns = 0;     // the driver's, on the monotonic clock
  std::optional<double> exposure_s;  // as Frame's
  // Either a JPEG, or a frame whose planes lie in the camera's buffer.
  std::span<const std::uint8_t> jpeg;
  Frame frame;  // set for a JPEG if it is decoded already
  std::shared_ptr<const void> owner;

  [[nodiscard]] bool is_jpeg() const { return !jpeg.empty(); }
};

struct StreamFormat {
  std::string name;  // "MJPEG", "NV12", ...
  int width = 0;     // [px]
  int height = 0;    // [px]
  double interval_s = 1.0 / 30.0;
  bool interval_granted = true;  // false: as requested, the camera does not report it
};

// "30/s", or "30/s as asked, or its own rate".
[[nodiscard]] std::string rate_in_words(const StreamFormat& format);
// Pause after a bad frame, as a camera may deliver them without end: half an interval, 100 ms at
// most.
[[nodiscard]] std::chrono::milliseconds bad_frame_pause(double interval_s);

// Focus of a lens, in the units of CameraControls.
struct FocusReading {
  double position = 0.0;
  double step = 1.0;  // resolution
};

class LiveSource : public FrameSource {
 public:
  // Waits for the next image, through faults and the camera's absence; empty after stop(), or at
  // the end. For one thread.
  [[nodiscard]] virtual Result<std::optional<CapturedImage>> next_image() = 0;
  // Decodes a JPEG. A damaged image is counted, and empty. By any thread.
  [[nodiscard]] std::optional<Frame> decode(const CapturedImage& image);

  [[nodiscard]] Result<std::optional<Frame>> next() override;
  [[nodiscard]] StageTime capture_time() const override { return capture_time_; }
  [[nodiscard]] std::optional<int> frame_count() const override { return std::nullopt; }

  // Ends a waiting next_image() and every later one. By any thread.
  virtual void stop() = 0;
  [[nodiscard]] virtual StreamFormat format() const = 0;
  [[nodiscard]] virtual std::string description() const = 0;  // for users: device, card, format
  [[nodiscard]] virtual FaultCounter& faults() = 0;
  // Ends the message about a damaged image.
  [[nodiscard]] virtual std::string_view damage_remedy() const;
  // Once frames come; empty if the camera does not report it.
  [[nodiscard]] virtual std::optional<FocusReading> focus() const { return std::nullopt; }
  // Current values of the camera's controls, by name. By any thread.
  [[nodiscard]] virtual std::vector<std::pair<std::string, std::int64_t>> controls() const {
    return {};
  }

 private:
  StageTime capture_time_;
};

// Counts the lost frames, wrong times and changes of rate of a frame's stamp. `format`: as granted.
void count_stamp(FaultCounter& faults, const FrameStamp& stamp, const StreamFormat& format);

}  // namespace penumbra
