#include "app/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace penumbra {

namespace {

std::string bar_text(int done, int total) {
  constexpr int kWidth = 30;
  const int filled = total > 0 ? std::clamp(done * kWidth / total, 0, kWidth) : 0;
  return fmt::format("[{:#<{}}{: <{}}]", "", filled, "", kWidth - filled);
}

}  // namespace

std::string step_text(const std::string& what, int step, int last, double elapsed_ms) {
  return fmt::format("{}  {}, {:.0f} s", bar_text(step - 1, last), what, 1e-3 * elapsed_ms);
}

std::string progress_text(int done, int total, double elapsed_ms, const std::string& unit) {
  const double rate = elapsed_ms > 0.0 ? done * 1e3 / elapsed_ms : 0.0;
  const std::string bar = bar_text(done, total);
  if (unit.empty()) return bar;
  return fmt::format("{} {:>4}/{}  {:.1f} {}/s", bar, done, total, rate, unit);
}

ProgressBar::ProgressBar(int total, std::string unit)
    : total_(total), unit_(std::move(unit)), terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() {
  if (terminal_) std::fputs("\r\033[K", stderr);
}

std::optional<double> ProgressBar::time_to_draw(bool at_once) {
  if (!terminal_) return std::nullopt;
  constexpr double kRedraw_ms = 100.0;
  const double now_ms = since_start_.elapsed().wall_ms;
  if (now_ms - last_drawn_ms_ < kRedraw_ms && !at_once) return std::nullopt;
  last_drawn_ms_ = now_ms;
  return now_ms;
}

void ProgressBar::draw(const std::string& text) {
  std::fprintf(stderr, "\r%s\033[K", text.c_str());
  std::fflush(stderr);
}

void ProgressBar::update(int done) {
  if (const auto now_ms = time_to_draw(done >= total_)) {
    draw(progress_text(done, total_, *now_ms, unit_));
  }
}

void ProgressBar::update(const std::string& what, int step, int last) {
  if (const auto now_ms = time_to_draw(false)) draw(step_text(what, step, last, *now_ms));
}

}  // namespace penumbra
