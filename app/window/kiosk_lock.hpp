// Lock of a kiosk's window: its keys and panels do nothing until staff unlock them.
#pragma once

#include "render/gl/context.hpp"

namespace penumbra {

inline constexpr const char* kUnlockKeys = "Ctrl + Shift + K";

class KioskLock {
 public:
  // `reset_after_s`: time without input after which the arrangement is reset; 0: never.
  explicit KioskLock(double reset_after_s) : reset_after_ms_(1e3 * reset_after_s) {}

  // Call this for each event. Returns true if the window may handle it: all events while unlocked,
  // else those of the pointer. kUnlockKeys unlock and lock. `now_ms`: any clock.
  [[nodiscard]] bool admits(const WindowEvent& event, double now_ms);
  [[nodiscard]] bool locked() const { return locked_; }
  // Returns true once after each time without input, and locks. Without any input since the
  // previous reset, nothing can have changed, and it returns false.
  [[nodiscard]] bool take_reset(double now_ms);
  // Returns false if the pointer has rested long enough to be hidden.
  [[nodiscard]] bool shows_pointer(double now_ms) const;

 private:
  double reset_after_ms_;
  bool locked_ = true;
  bool touched_ = false;  // since the latest reset
  double last_input_ms_ = -1e9;
};

}  // namespace penumbra
