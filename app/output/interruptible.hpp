// Work that writes one file and cannot be stopped half way, under Ctrl-C and SIGTERM.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <future>
#include <string>
#include <utility>

#include "app/interrupt.hpp"
#include "app/output/output_file.hpp"

namespace penumbra {

// Waits for the work up to `time`. On a signal the partial file is removed and the process ends at
// once: the work's thread asks nobody. `watch` must hold.
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

}  // namespace penumbra
