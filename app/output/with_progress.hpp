// Work that writes one file, with a progress bar where it takes longer than a person waits in
// peace.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <future>
#include <limits>
#include <optional>
#include <string>

#include "app/interrupt.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "app/progress.hpp"

namespace penumbra {

// Runs `work` on a thread of its own and returns what it returns. After a second a bar shows how
// far `progress` (atomic counts `done` of `total`, of `unit`) is; an empty bar until there is a
// total. On a signal the partial file of `output` is removed and the process ends; `watch` must
// hold.
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
      constexpr auto kMost = static_cast<std::size_t>(std::numeric_limits<int>::max());
      if (total > 0 && total <= kMost && !counting) {
        counting = true;
        bar.emplace(static_cast<int>(total), unit);
      }
      bar->update(counting ? static_cast<int>(std::min<std::size_t>(progress.done, total)) : 0);
    } while (!is_done_within(running, 100ms, watch, output));
  }
  return running.get();
}

}  // namespace penumbra
