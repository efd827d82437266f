// Ctrl-C and SIGTERM as a question that a loop asks, so that files are closed before the end.
#pragma once

#include <csignal>

namespace penumbra {

// From construction on, SIGINT and SIGTERM wait in the kernel: for this thread and for every thread
// it starts, so make one before anything that starts threads (OpenGL, decoders). No handler and no
// global is needed.
class InterruptWatch {
 public:
  InterruptWatch();
  InterruptWatch(const InterruptWatch&) = delete;
  InterruptWatch& operator=(const InterruptWatch&) = delete;
  ~InterruptWatch();

  // True from the first signal on. That signal is taken; a second one then ends the process at
  // once, should closing the files hang.
  [[nodiscard]] bool interrupted();

 private:
  sigset_t watched_{};
  sigset_t before_{};
  bool interrupted_ = false;
};

}  // namespace penumbra
