// A progress bar on standard error where that is a terminal; nothing anywhere else.
#pragma once

#include <string>

#include "core/stopwatch.hpp"

namespace penumbra {

class ProgressBar {
 public:
  explicit ProgressBar(int total);
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;
  ~ProgressBar();  // takes the bar away

  void update(int done);

 private:
  int total_ = 0;
  bool terminal_ = false;
  Stopwatch since_start_;
  double last_drawn_ms_ = -1e9;
};

// "[######          ]  45/120  31.2 frames/s"
[[nodiscard]] std::string progress_text(int done, int total, double elapsed_ms);

}  // namespace penumbra
