// Source of live frames: a camera, or a recording played as one. A slow reader loses frames.
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
  std::uint64_t sequence = 0;          // counts from 0; lost frames leave gaps
  std::int64_t timestamp_ns = 0;       // from the FrameStamp, on the monotonic clock
  std::optional<std::int64_t> utc_ns;  // see Frame::utc_ns
  std::optional<double> exposure_s;    // see Frame::exposure_s
  // The image is either a JPEG, or a frame whose planes lie in the camera's buffer.
  std::span<const std::uint8_t> jpeg;
  Frame frame;                        // also set for a JPEG that is already decoded
  std::shared_ptr<const void> owner;  // keeps the memory of `jpeg` or `frame` valid

  [[nodiscard]] bool is_jpeg() const { return !jpeg.empty(); }
};

struct StreamFormat {
  std::string name;  // "MJPEG", "NV12", ...
  int width = 0;     // [px]
  int height = 0;    // [px]
  double interval_s = 1.0 / 30.0;
  bool interval_granted = true;  // false: interval_s is the requested one; the camera reports none
};

// Returns "30/s"; if the camera does not report its rate, "30/s as asked, or its own rate".
[[nodiscard]] std::string rate_text(const StreamFormat& format);
// Returns the pause after a bad frame (a camera may deliver no others): half an interval, 1 to 100
// ms.
[[nodiscard]] std::chrono::milliseconds bad_frame_pause(double interval_s);

// Focus of a lens, in the units of CameraControls.
struct FocusReading {
  double position = 0.0;
  double step = 1.0;  // resolution
};

class LiveSource : public FrameSource {
 public:
  // Waits for the next image, even during faults or while the camera is disconnected. Returns
  // nullopt after stop() or at the end. Not thread-safe.
  [[nodiscard]] virtual Result<std::optional<CapturedImage>> next_image() = 0;
  // Decodes a JPEG. Counts a damaged image and returns nullopt for it. Thread-safe.
  [[nodiscard]] std::optional<Frame> decode(const CapturedImage& image);

  [[nodiscard]] Result<std::optional<Frame>> next() override;
  [[nodiscard]] StageTime capture_time() const override { return capture_time_; }
  [[nodiscard]] std::optional<int> frame_count() const override { return std::nullopt; }

  // Ends a waiting next_image() and all later ones. Thread-safe.
  virtual void stop() = 0;
  [[nodiscard]] virtual StreamFormat format() const = 0;
  [[nodiscard]] virtual std::string description() const = 0;  // for users: device, card, format
  [[nodiscard]] virtual FaultCounter& faults() = 0;
  // End of the message about a damaged image.
  [[nodiscard]] virtual std::string_view damage_remedy() const;
  // Returns the focus after the first frame; nullopt if the camera does not report it.
  [[nodiscard]] virtual std::optional<FocusReading> focus() const { return std::nullopt; }
  // Returns the current values of the camera's controls by name. Thread-safe.
  [[nodiscard]] virtual std::vector<std::pair<std::string, std::int64_t>> controls() const {
    return {};
  }

 private:
  StageTime capture_time_;
};

// Counts the lost frames, wrong times and rate changes of a stamp. `format`: the granted one.
void count_stamp(FaultCounter& faults, const FrameStamp& stamp, const StreamFormat& format);

}  // namespace penumbra
