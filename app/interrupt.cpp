#include "app/interrupt.hpp"

#include <ctime>

namespace penumbra {

InterruptWatch::InterruptWatch() {
  sigemptyset(&watched_);
  sigaddset(&watched_, SIGINT);
  sigaddset(&watched_, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &watched_, &before_);
}

InterruptWatch::~InterruptWatch() {
  if (!interrupted_) pthread_sigmask(SIG_SETMASK, &before_, nullptr);
}

bool InterruptWatch::interrupted() {
  if (interrupted_) return true;
  const timespec at_once{};
  if (sigtimedwait(&watched_, nullptr, &at_once) > 0) {
    interrupted_ = true;
    pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  return interrupted_;
}

}  // namespace penumbra
