// Runs long work on its own thread and handles Ctrl-C and SIGTERM meanwhile.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <future>
#include <limits>
#include <optional>
#include <stop_token>
#include <string>
#include <utility>

#include "app/interrupt.hpp"
#include "app/output/output_file.hpp"
#include "app/progress.hpp"

namespace penumbra {

// Waits up to `time` for work that can't be stopped; returns true if the work is done. On a signal,
// removes the partial file and ends the process at once. Call watch.hold() before.
template <class T>
[[nodiscard]] bool is_done_within(std::future<T>& work, std::chrono::milliseconds time,
                                  InterruptWatch& watch, OutputFile& output) {
  constexpr std::chrono::milliseconds kStep(50);
  do {
    const auto step = std::min(time, kStep);
    if (work.wait_for(step) == std::future_status::ready) return true;
    if (watch.interrupted()) {
      const std::string name = output.target().string();
      { const OutputFile removed = std::move(output); }
      fmt::print(stderr, "penumbra: error: {}: ended early; no file was written\n", name);
      std::_Exit(EXIT_FAILURE);
    }
    time -= step;
  } while (time.count() > 0);
  return false;
}

// Runs `work`, which writes one file and can't be stopped (see is_done_within()), and returns its
// result. After one second a bar shows `progress` (atomic counters `done` and `total`, counted in
// `unit`). The bar is empty while `total` is 0.
template <class Work, class Progress>
auto with_progress(const Work& work, const Progress& progress, const std::string& unit,
                   InterruptWatch& watch, OutputFile& output) {
  using namespace std::chrono_literals;
  auto running = std::async(std::launch::async, work);
  if (!is_done_within(running, 1s, watch, output)) {
    std::optional<ProgressBar> bar(std::in_place, 1, "");
    bool counting = false;
    do {
      const std::size_t total = progress.total;
      constexpr auto kMaxTotal = static_cast<std::size_t>(std::numeric_limits<int>::max());
      if (total > 0 && total <= kMaxTotal && !counting) {
        counting = true;
        bar.emplace(static_cast<int>(total), unit);
      }
      bar->update(counting ? static_cast<int>(std::min<std::size_t>(progress.done, total)) : 0);
    } while (!is_done_within(running, 100ms, watch, output));
  }
  return running.get();
}

// Runs `work(std::stop_token)` and returns its result. The first signal requests the stop.
// Meanwhile this thread repeatedly calls `turn()`, to draw a window. Call watch.hold() before.
template <class Work, class Turn = decltype([] {})>
[[nodiscard]] auto run_stoppable(InterruptWatch& watch, const Work& work, const Turn& turn = {}) {
  constexpr std::chrono::milliseconds kTurn(15);
  std::stop_source stop;
  auto running =
      std::async(std::launch::async, [&work, token = stop.get_token()] { return work(token); });
  while (running.wait_for(kTurn) != std::future_status::ready) {
    if (watch.interrupted()) stop.request_stop();
    turn();
  }
  return running.get();
}

}  // namespace penumbra
