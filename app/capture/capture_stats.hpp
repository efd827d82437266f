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
  silent,        // stream stall: neither a frame nor an error arrives
  io_error,      // EIO and other errors while streaming
  disconnected,  // ENODEV: unplugged, or reset
  refused,       // EINVAL: the driver refused a valid call
  busy,          // another program used the camera when it was opened again
  forbidden,     // the user had no permission when the camera was opened again
  wrong_format,  // another size or format than before
  error_frame,   // marked as bad by the driver, or empty
  damaged,       // a JPEG that can't be decoded
  gap,           // gap in the driver's sequence numbers
  silent_gap,    // gap only in the timestamps
  bad_time,      // an impossible timestamp
  slow_rate,     // frame rate below the granted or the earlier rate
  no_signal,     // the driver reports no signal at the input; keep it last
};
inline constexpr std::size_t kCaptureFaultCount =
    static_cast<std::size_t>(CaptureFault::no_signal) + 1;

// Name in reports: "disconnected".
[[nodiscard]] std::string_view name_of(CaptureFault fault);
// Text for users: "frames dropped, by the driver's numbers".
[[nodiscard]] std::string_view description_of(CaptureFault fault);

struct CaptureStats {
  std::uint64_t frames = 0;     // number of delivered frames
  std::uint64_t undecoded = 0;  // number of damaged frames among these (detected while decoding)
  std::array<std::uint64_t, kCaptureFaultCount> faults{};
  std::uint64_t restarts = 0;          // number of restarts of the stream
  std::optional<std::string> trouble;  // current fault, in a few words for the HUD
  [[nodiscard]] std::uint64_t of(CaptureFault fault) const {
    return faults[static_cast<std::size_t>(fault)];
  }
};

// Thread-safe counter of faults. Logs the first of each kind as a warning, later ones as debug.
class FaultCounter {
 public:
  explicit FaultCounter(std::string camera) : camera_(std::move(camera)) {}
  void count(CaptureFault fault, std::string_view detail, std::uint64_t times = 1);
  void count_frame();
  void count_undecoded(std::string_view detail);
  void count_restart();
  // Sets the current fault; nullopt: it is over.
  void set_trouble(std::optional<std::string> trouble);
  [[nodiscard]] CaptureStats stats() const;
  struct Event {
    std::int64_t timestamp_ns;  // when the fault was counted, on the monotonic clock
    CaptureFault fault;
    std::string detail;
  };
  // Returns the faults since the previous call, for the events of a recording.
  [[nodiscard]] std::vector<Event> take_events();

 private:
  const std::string camera_;
  mutable std::mutex mutex_;
  CaptureStats stats_;         // guarded by mutex_
  std::vector<Event> events_;  // guarded by mutex_
};

}  // namespace penumbra
