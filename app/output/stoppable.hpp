// Long work that ends when it is asked to, under Ctrl-C and SIGTERM.
#pragma once

#include <chrono>
#include <future>
#include <stop_token>

#include "app/interrupt.hpp"

namespace penumbra {

// Runs `work(std::stop_token)` on a thread of its own and returns what it returns; the first signal
// requests the stop, `watch` must hold. Meanwhile `turn()` is called again and again by this thread
// (a window wants to be drawn).
template <class Work, class Turn>
[[nodiscard]] auto run_stoppable(InterruptWatch& watch, const Work& work, const Turn& turn) {
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
template <class Work>
[[nodiscard]] auto run_stoppable(InterruptWatch& watch, const Work& work) {
  return run_stoppable(watch, work, [] {});
}

}  // namespace penumbra
