// Turns Ctrl-C, SIGTERM and a closed terminal into a flag that loops poll, so that files are closed
// before the end.
#pragma once

#include <atomic>
#include <chrono>
#include <csignal>
#include <thread>

namespace penumbra {

// Blocks SIGINT, SIGTERM and SIGHUP in this thread and all that it starts; construct it before
// anything that starts threads (OpenGL, decoders). Until hold(), a thread takes them and ends the
// process at once, as if they were not blocked.
//
// SIGHUP stays ignored if it was (nohup). The other two are always watched, because shells start
// the background jobs of a script with SIGINT ignored.
class InterruptWatch {
 public:
  InterruptWatch();
  InterruptWatch(const InterruptWatch&) = delete;
  InterruptWatch& operator=(const InterruptWatch&) = delete;
  ~InterruptWatch();

  // Call it before the first file is opened. From here on signals only set interrupted().
  void hold();
  // True from the first signal after hold() on. Signals within the next second belong to the same
  // request: a closing terminal and timeout(1) send several. A later SIGINT or SIGTERM ends the
  // process at once.
  [[nodiscard]] bool interrupted();
  // Clears interrupted(): the next signal sets it again.
  void again();

 private:
  using Clock = std::chrono::steady_clock;

  void start_ender(Clock::time_point from, bool by_hangup);
  void stop_ender();

  sigset_t watched_{};
  sigset_t before_{};
  bool interrupted_ = false;
  Clock::time_point request_ends_ = Clock::time_point::min();
  std::atomic<bool> stopped_ = false;
  std::thread ender_;  // until hold(), and once interrupted
};

}  // namespace penumbra
