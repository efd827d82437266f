// Faults of a camera: each is counted, and the first of each kind is logged.
#pragma once

#include <array>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace penumbra {

enum class CaptureFault {
  silent,        // no frame and no error for a while
  io_error,      // EIO and what else fails while streaming
  disconnected,  // ENODEV: unplugged, or reset
  refused,       // EINVAL: a call that should have worked
  busy,          // held by another program when it was opened again
  forbidden,     // no permission when it was opened again
  wrong_format,  // another size or format than before
  error_frame,   // flagged as bad by the driver, or empty
  damaged,       // half a JPEG, or one that can't be decoded
  gap,           // frames missing by the driver's numbers
  silent_gap,    // frames missing by their times only
  bad_time,      // a timestamp that can't be true
  slow_rate,     // fewer frames per second than granted, or than before
  no_signal,     // nothing connected to the input, by the driver
};
inline constexpr std::size_t kCaptureFaultCount = 14;

// As in reports: "disconnected".
[[nodiscard]] std::string_view name_of(CaptureFault fault);

// For people: "frames dropped, by the driver's numbers".
[[nodiscard]] std::string_view description_of(CaptureFault fault);

struct CaptureStats {
  std::uint64_t frames = 0;     // handed out
  std::uint64_t undecoded = 0;  // of these: damaged, as was found when they were decoded
  std::array<std::uint64_t, kCaptureFaultCount> faults{};
  std::uint64_t restarts = 0;          // times the stream was set up again
  std::optional<std::string> trouble;  // what is wrong right now, in a few words for the HUD
  [[nodiscard]] std::uint64_t of(CaptureFault fault) const {
    return faults[static_cast<std::size_t>(fault)];
  }
};

// Counts faults from any thread. The first of each kind goes to the log as a warning, later ones
// only to its debug level.
class FaultCounter {
 public:
  explicit FaultCounter(std::string camera) : camera_(std::move(camera)) {}
  void count(CaptureFault fault, std::string_view detail, std::uint64_t times = 1);
  void count_frame();
  void count_undecoded(std::string_view detail);
  void count_restart();
  // What is wrong right now; nothing: it is over.
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
