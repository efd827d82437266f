// A progress bar on standard error if that is a terminal.
#pragma once

#include <optional>
#include <string>

#include "core/stopwatch.hpp"

namespace penumbra {

class ProgressBar {
 public:
  // `unit`: name of the counted items. If it is empty, only the bar is drawn, without a rate.
  explicit ProgressBar(int total, std::string unit = "frames");
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;
  ~ProgressBar();  // clears the bar

  void update(int done);
  // Shows the number `step` of a step (1 to at most `last`), `what` it does, and the elapsed time.
  void update(const std::string& what, int step, int last);

 private:
  // Returns the time since the start [ms] if the bar is to be drawn now.
  [[nodiscard]] std::optional<double> time_to_draw(bool at_once);
  static void draw(const std::string& text);
  int total_ = 0;
  std::string unit_;
  bool terminal_ = false;
  Stopwatch since_start_;
  double last_drawn_ms_ = -1e9;
};

// Returns "[######          ]  45/120  31.2 frames/s".
[[nodiscard]] std::string progress_text(int done, int total, double elapsed_ms,
                                        const std::string& unit = "frames");
// Returns "[####              ]  what, 12 s"; the bar is empty at step 1.
[[nodiscard]] std::string step_text(const std::string& what, int step, int last, double elapsed_ms);

}  // namespace penumbra
