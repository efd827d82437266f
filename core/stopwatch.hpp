// Wall and CPU time of a piece of work on one thread.
#pragma once

#include <ctime>

namespace penumbra {

struct StageTime {
  double wall_ms = 0.0;
  double cpu_ms = 0.0;  // CPU time of the thread that did the work
};

class Stopwatch {
 public:
  Stopwatch() { restart(); }
  void restart() {
    wall_ms_ = now_ms(CLOCK_MONOTONIC);
    cpu_ms_ = now_ms(CLOCK_THREAD_CPUTIME_ID);
  }
  // Time since construction or restart(). Call it on the same thread.
  [[nodiscard]] StageTime elapsed() const {
    return {now_ms(CLOCK_MONOTONIC) - wall_ms_, now_ms(CLOCK_THREAD_CPUTIME_ID) - cpu_ms_};
  }
  // Adds elapsed().
  void add_to(double& wall_ms, double& cpu_ms) const {
    const StageTime time = elapsed();
    wall_ms += time.wall_ms;
    cpu_ms += time.cpu_ms;
  }

 private:
  static double now_ms(clockid_t clock) {
    timespec t{};
    clock_gettime(clock, &t);
    return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_nsec) * 1e-6;
  }
  double wall_ms_ = 0.0;
  double cpu_ms_ = 0.0;
};

}  // namespace penumbra
