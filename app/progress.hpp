// A progress bar on standard error where that is a terminal; nothing anywhere else.
#pragma once

#include <string>

#include "core/stopwatch.hpp"

namespace penumbra {

class ProgressBar {
 public:
  // `unit`: what is counted, for the rate; without one only the bar is drawn.
  explicit ProgressBar(int total, std::string unit = "frames");
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;
  ~ProgressBar();  // takes the bar away

  void update(int done);

 private:
  int total_ = 0;
  std::string unit_;
  bool terminal_ = false;
  Stopwatch since_start_;
  double last_drawn_ms_ = -1e9;
};

// "[######          ]  45/120  31.2 frames/s"
[[nodiscard]] std::string progress_text(int done, int total, double elapsed_ms,
                                        const std::string& unit = "frames");

}  // namespace penumbra
