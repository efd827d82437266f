// Ctrl-C and SIGTERM as a question that a loop asks, so that files are closed before the end.
#pragma once

#include <atomic>
#include <csignal>
#include <thread>

namespace penumbra {

// From construction on, SIGINT, SIGTERM and SIGHUP are blocked in this thread and in every thread
// it starts, so make one before anything that starts threads (OpenGL, decoders). Until hold() a
// thread of its own takes them and ends the process at once, as without this. No handler and no
// global is needed.
class InterruptWatch {
 public:
  InterruptWatch();
  InterruptWatch(const InterruptWatch&) = delete;
  InterruptWatch& operator=(const InterruptWatch&) = delete;
  ~InterruptWatch();

  // Call it before the first file is opened: from here on a signal waits to be asked for.
  void hold();
  // True from the first signal after hold() on. That signal is taken; a second one then ends the
  // process at once, should closing the files hang.
  [[nodiscard]] bool interrupted();
  // The signal is answered, and something else begins: the next one is asked for as it was.
  void again();

 private:
  sigset_t watched_{};
  sigset_t before_{};
  bool interrupted_ = false;
  std::atomic<bool> held_ = false;
  std::thread ender_;  // until hold()
};

}  // namespace penumbra
