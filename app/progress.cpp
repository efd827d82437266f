#include "app/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace penumbra {

std::string progress_text(int done, int total, double elapsed_ms, const std::string& unit) {
  constexpr int kWidth = 30;
  const int filled = total > 0 ? std::clamp(done * kWidth / total, 0, kWidth) : 0;
  const double rate = elapsed_ms > 0.0 ? done * 1e3 / elapsed_ms : 0.0;
  const std::string bar = fmt::format("[{:#<{}}{: <{}}]", "", filled, "", kWidth - filled);
  if (unit.empty()) return bar;
  return fmt::format("{} {:>4}/{}  {:.1f} {}/s", bar, done, total, rate, unit);
}

ProgressBar::ProgressBar(int total, std::string unit)
    : total_(total), unit_(std::move(unit)), terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() {
  if (terminal_) std::fputs("\r\033[K", stderr);
}

void ProgressBar::update(int done) {
  if (!terminal_) return;
  constexpr double kRedraw_ms = 100.0;
  const double now_ms = since_start_.elapsed().wall_ms;
  if (now_ms - last_drawn_ms_ < kRedraw_ms && done < total_) return;
  last_drawn_ms_ = now_ms;
  std::fprintf(stderr, "\r%s\033[K", progress_text(done, total_, now_ms, unit_).c_str());
  std::fflush(stderr);
}

}  // namespace penumbra
