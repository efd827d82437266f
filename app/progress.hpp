// A progress bar on standard error where that is a terminal; nothing anywhere else.
#pragma once

#include <optional>
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
  // In place of a count: what is going on, as step `step` of at most `most`, and for how long.
  void update(const std::string& what, int step, int most);

 private:
  [[nodiscard]] std::optional<double> time_to_draw(bool at_once);
  int total_ = 0;
  std::string unit_;
  bool terminal_ = false;
  Stopwatch since_start_;
  double last_drawn_ms_ = -1e9;
};

// "[######          ]  45/120  31.2 frames/s"
[[nodiscard]] std::string progress_text(int done, int total, double elapsed_ms,
                                        const std::string& unit = "frames");
// "[####              ]  what, 12 s": step 1 leaves the bar empty.
[[nodiscard]] std::string step_text(const std::string& what, int step, int most, double elapsed_ms);

}  // namespace penumbra
