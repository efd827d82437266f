#include "app/interrupt.hpp"

#include <unistd.h>

#include <ctime>

namespace penumbra {
namespace {

constexpr std::chrono::milliseconds kRequest(1000);  // longest time between signals of one request

bool is_ignored(int number) {
  struct sigaction action {};
  return sigaction(number, nullptr, &action) == 0 && action.sa_handler == SIG_IGN;
}

bool take_signal(const sigset_t& watched) {
  const timespec at_once{};
  return sigtimedwait(&watched, nullptr, &at_once) > 0;
}

}  // namespace

InterruptWatch::InterruptWatch() {
  sigemptyset(&watched_);
  sigaddset(&watched_, SIGINT);
  sigaddset(&watched_, SIGTERM);
  if (!is_ignored(SIGHUP)) sigaddset(&watched_, SIGHUP);
  pthread_sigmask(SIG_BLOCK, &watched_, &previous_mask_);
  start_terminator(Clock::time_point::min(), true);
}

InterruptWatch::~InterruptWatch() {
  stop_terminator();
  // A pending signal would kill the process although its files are closed.
  while (take_signal(watched_)) {
  }
  pthread_sigmask(SIG_SETMASK, &previous_mask_, nullptr);
}

void InterruptWatch::hold() {
  stop_terminator();
}

bool InterruptWatch::interrupted() {
  if (interrupted_) return true;
  if (terminator_.joinable() || !take_signal(watched_)) return false;
  const auto now = Clock::now();
  if (now < request_ends_) return false;
  interrupted_ = true;
  request_ends_ = now + kRequest;
  start_terminator(request_ends_, false);
  return true;
}

void InterruptWatch::clear_interrupted() {
  if (!interrupted_) return;
  stop_terminator();
  interrupted_ = false;
}

// Starts the thread that ends the process at the first signal after `from`. SIGHUP ends the process
// only if `by_hangup` is set.
void InterruptWatch::start_terminator(Clock::time_point from, bool by_hangup) {
  stopped_ = false;
  terminator_ = std::thread([this, from, by_hangup] {
    while (true) {
      siginfo_t info{};
      const int number = sigwaitinfo(&watched_, &info);
      if (number <= 0) continue;
      if (stopped_) {
        // Another process's signal, received before that of stop_terminator(), must stay pending.
        if (info.si_pid != getpid()) kill(getpid(), number);
        return;
      }
      if (Clock::now() < from || (number == SIGHUP && !by_hangup)) continue;
      std::signal(number, SIG_DFL);
      pthread_sigmask(SIG_UNBLOCK, &watched_, nullptr);
      std::raise(number);
    }
  });
}

void InterruptWatch::stop_terminator() {
  if (!terminator_.joinable()) return;
  stopped_ = true;
  pthread_kill(terminator_.native_handle(), SIGTERM);  // sends it to that thread only
  terminator_.join();
}

}  // namespace penumbra
