#include "app/interrupt.hpp"

#include <ctime>

namespace penumbra {
namespace {

// Ends the process by the first signal, unless hold() sent it.
void end_by_signal(const sigset_t& watched, const std::atomic<bool>& held) {
  int number = 0;
  while (sigwait(&watched, &number) != 0) {
  }
  if (held) return;
  std::signal(number, SIG_DFL);
  pthread_sigmask(SIG_UNBLOCK, &watched, nullptr);
  std::raise(number);
}

}  // namespace

InterruptWatch::InterruptWatch() {
  sigemptyset(&watched_);
  sigaddset(&watched_, SIGINT);
  sigaddset(&watched_, SIGTERM);
  sigaddset(&watched_, SIGHUP);  // its terminal was closed
  pthread_sigmask(SIG_BLOCK, &watched_, &before_);
  ender_ = std::thread([this] { end_by_signal(watched_, held_); });
}

InterruptWatch::~InterruptWatch() {
  hold();
  if (!interrupted_) pthread_sigmask(SIG_SETMASK, &before_, nullptr);
}

void InterruptWatch::hold() {
  if (!ender_.joinable()) return;
  held_ = true;
  pthread_kill(ender_.native_handle(), SIGTERM);  // to that thread alone
  ender_.join();
}

bool InterruptWatch::interrupted() {
  if (interrupted_) return true;
  const timespec at_once{};
  if (!ender_.joinable() && sigtimedwait(&watched_, nullptr, &at_once) > 0) {
    interrupted_ = true;
    pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  return interrupted_;
}

void InterruptWatch::again() {
  if (!interrupted_) return;
  pthread_sigmask(SIG_BLOCK, &watched_, nullptr);
  interrupted_ = false;
}

}  // namespace penumbra
