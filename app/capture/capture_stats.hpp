// Faults of a camera: each is counted; the first of each kind is logged.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace penumbra {

enum class CaptureFault {
  silent,        // no frame and no error: the stream stalls
  io_error,      // EIO and other errors while streaming
  disconnected,  // ENODEV: unplugged, or reset
  refused,       // EINVAL: a call that should have worked
  busy,          // used by another program when it was opened again
  forbidden,     // no permission when it was opened again
  wrong_format,  // another size or format than before
  error_frame,   // marked as bad by the driver, or empty
  damaged,       // a JPEG that can't be decoded
  gap,           // frames missing by the driver's numbers
  silent_gap,    // frames missing only by their times
  bad_time,      // an impossible timestamp
  slow_rate,     // fewer frames per second than granted or before
  no_signal,     // nothing connected to the input, by the driver; stays last
};
inline constexpr std::size_t kCaptureFaultCount =
    static_cast<std::size_t>(CaptureFault::no_signal) + 1;

// As in reports: "disconnected".
[[nodiscard]] std::string_view name_of(CaptureFault fault);
// For users: "frames dropped, by the driver's numbers".
[[nodiscard]] std::string_view description_of(CaptureFault fault);

struct CaptureStats {
  std::uint64_t frames = 0;     // delivered
  std::uint64_t undecoded = 0;  // of these: found damaged while decoding
  std::array<std::uint64_t, kCaptureFaultCount> faults{};
  std::uint64_t restarts = 0;          // of the stream
  std::optional<std::string> trouble;  // current fault, in a few words for the HUD
  [[nodiscard]] std::uint64_t of(CaptureFault fault) const {
    return faults[static_cast<std::size_t>(fault)];
  }
};

// Counts faults from any thread. Logs the first of each kind as a warning, later ones at debug
// level.
class FaultCounter {
 public:
  explicit FaultCounter(std::string camera) : camera_(std::move(camera)) {}
  void count(CaptureFault fault, std::string_view detail, std::uint64_t times = 1);
  void count_frame();
  void count_undecoded(std::string_view detail);
  void count_restart();
  // The current fault; empty: it is over.
  void set_trouble(std::optional<std::string> trouble);
  [[nodiscard]] CaptureStats stats() const;
  // The faults counted since the last call, for the events of a recording.
  struct Event {
    std::int64_t timestamp_ns;  // when it was counted, on the monotonic clock
    CaptureFault fault;
    std::string detail;
  };
  [[nodiscard]] std::vector<Event> take_events();

 private:
  const std::string camera_;
  mutable std::mutex mutex_;
  CaptureStats stats_;         // guarded by mutex_
  std::vector<Event> events_;  // guarded by mutex_
};

}  // namespace penumbra
