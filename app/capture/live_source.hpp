// A camera, or what stands for one: frames come at their own pace, and who is late loses some.
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

// One picture as the camera gave it.
struct CapturedImage {
  std::uint64_t sequence = 0;        // from 0; a gap is a lost frame
  std::int64_t timestamp_ns = 0;     // the driver's, on the monotonic clock
  std::optional<double> exposure_s;  // as Frame's
  // Either a JPEG, or a frame whose planes lie in the camera's buffer.
  std::span<const std::uint8_t> jpeg;
  Frame frame;  // of a JPEG: where it is decoded already
  std::shared_ptr<const void> owner;

  [[nodiscard]] bool is_jpeg() const { return !jpeg.empty(); }
};

// What the stream is, once it runs.
struct StreamFormat {
  std::string name;  // "MJPEG", "NV12", ...
  int width = 0;     // [px]
  int height = 0;    // [px]
  double interval_s = 1.0 / 30.0;
  bool interval_granted = true;  // else that is what was asked for: the camera does not say
};

// "30/s"; or that that was asked for, and may not be.
[[nodiscard]] std::string rate_in_words(const StreamFormat& format);
// How long to wait after a frame that is none before the next one is asked for: half an interval,
// 100 ms at most.
[[nodiscard]] std::chrono::milliseconds bad_frame_pause(double interval_s);

// Where a lens is focused, in the units of CameraControls.
struct FocusReading {
  double position = 0.0;
  double step = 1.0;  // as fine as it can be read
};

class LiveSource : public FrameSource {
 public:
  // Waits for the next picture, through faults and the camera's absence; nothing after stop(), or
  // when there is no more. Called by one thread.
  [[nodiscard]] virtual Result<std::optional<CapturedImage>> next_image() = 0;
  // Decodes where that is needed. A picture that is damaged is counted, and is nothing. By any
  // thread.
  [[nodiscard]] std::optional<Frame> decode(const CapturedImage& image);

  // The next whole frame, decoded.
  [[nodiscard]] Result<std::optional<Frame>> next() override;
  [[nodiscard]] StageTime capture_time() const override { return capture_time_; }
  [[nodiscard]] std::optional<int> frame_count() const override { return std::nullopt; }

  // Ends a next_image() that waits, and every later one at once. By any thread.
  virtual void stop() = 0;
  [[nodiscard]] virtual StreamFormat format() const = 0;
  [[nodiscard]] virtual std::string description() const = 0;  // for people: device, card, format
  [[nodiscard]] virtual FaultCounter& faults() = 0;
  // Ends the message about a damaged image.
  [[nodiscard]] virtual std::string_view damage_remedy() const;
  // Once frames come; nothing where the camera does not say.
  [[nodiscard]] virtual std::optional<FocusReading> focus() const { return std::nullopt; }
  // The camera's controls as they are now: name -> value. By any thread.
  [[nodiscard]] virtual std::vector<std::pair<std::string, std::int64_t>> controls() const = 0;

 private:
  StageTime capture_time_;
};

// Counts the lost frames, wrong times and changes of rate that a frame's stamp reports. `format`:
// what was granted.
void count_stamp(FaultCounter& faults, const FrameStamp& stamp, const StreamFormat& format);

}  // namespace penumbra
