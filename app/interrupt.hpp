// Ctrl-C, SIGTERM and a closed terminal as a question that a loop asks, so that files are closed
// before the end.
#pragma once

#include <atomic>
#include <chrono>
#include <csignal>
#include <thread>

namespace penumbra {

// From construction on, SIGINT, SIGTERM and SIGHUP are blocked in this thread and in every thread
// it starts, so make one before anything that starts threads (OpenGL, decoders). Until hold() a
// thread of its own takes them and ends the process at once, as without this. No handler and no
// global is needed.
//
// SIGHUP is left alone where it was ignored at the start (nohup): blocking it would undo that. The
// other two are watched in any case, because shells start the background jobs of a script with
// SIGINT ignored, and a signal is how such a job is ended.
class InterruptWatch {
 public:
  InterruptWatch();
  InterruptWatch(const InterruptWatch&) = delete;
  InterruptWatch& operator=(const InterruptWatch&) = delete;
  ~InterruptWatch();

  // Call it before the first file is opened: from here on a signal waits to be asked for.
  void hold();
  // True from the first signal after hold() on. Signals in the second after it belong to the same
  // request: a closing terminal and timeout(1) send several. A later SIGINT or SIGTERM ends the
  // process at once, should closing the files hang.
  [[nodiscard]] bool interrupted();
  // The signal is answered, and something else begins: the next one is asked for as it was.
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
