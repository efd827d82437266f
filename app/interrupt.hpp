// Turns Ctrl-C, SIGTERM and a closed terminal into a flag that loops poll, so that files are closed
// before the process ends.
#pragma once

#include <atomic>
#include <chrono>
#include <csignal>
#include <thread>

namespace penumbra {

// Blocks SIGINT, SIGTERM and SIGHUP in this thread and in every thread that it starts later.
// Construct it before OpenGL and the decoders, which start threads. Until hold(), a helper thread
// receives the signals and ends the process at once, as if they were not blocked.
//
// SIGHUP stays ignored if it was ignored before (nohup). SIGINT and SIGTERM are always watched,
// because shells start the background jobs of a script with SIGINT ignored.
class InterruptWatch {
 public:
  InterruptWatch();
  InterruptWatch(const InterruptWatch&) = delete;
  InterruptWatch& operator=(const InterruptWatch&) = delete;
  ~InterruptWatch();

  // Call this before the first file is opened. From then on a signal only sets interrupted().
  void hold();
  // Returns true after the first signal since hold(). Signals within the next second count as the
  // same request, because a closing terminal and timeout(1) send several. A later SIGINT or SIGTERM
  // ends the process at once.
  [[nodiscard]] bool interrupted();
  // Clears interrupted(). The next request (a second or more after the last) sets it again.
  void clear_interrupted();

 private:
  using Clock = std::chrono::steady_clock;

  void start_terminator(Clock::time_point from, bool by_hangup);
  void stop_terminator();

  sigset_t watched_{};
  sigset_t previous_mask_{};
  bool interrupted_ = false;
  Clock::time_point request_ends_ = Clock::time_point::min();
  std::atomic<bool> stopped_ = false;
  std::thread
      terminator_;  // ends the process on a signal; runs until hold() and after an interruption
};

}  // namespace penumbra
