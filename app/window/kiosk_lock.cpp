#include "app/window/kiosk_lock.hpp"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

namespace penumbra {
namespace {

constexpr double kPointerShown_ms = 3000.0;

}  // namespace

bool KioskLock::admits(const WindowEvent& event, double now_ms) {
  using Kind = WindowEvent::Kind;
  const bool by_pointer = event.kind == Kind::button_down || event.kind == Kind::button_up ||
                          event.kind == Kind::pointer_moved || event.kind == Kind::scrolled;
  if (by_pointer || !locked_) {
    touched_ = true;
    last_input_ms_ = now_ms;
  }
  if (event.kind == Kind::key_down && event.code == GLFW_KEY_K && event.control && event.shift) {
    locked_ = !locked_;
    touched_ = true;
    last_input_ms_ = now_ms;
    return false;
  }
  return by_pointer || !locked_;
}

bool KioskLock::take_reset(double now_ms) {
  if (!touched_ || reset_after_ms_ <= 0.0 || now_ms - last_input_ms_ < reset_after_ms_)
    return false;
  touched_ = false;
  locked_ = true;
  return true;
}

bool KioskLock::shows_pointer(double now_ms) const {
  return !locked_ || now_ms - last_input_ms_ < kPointerShown_ms;
}

}  // namespace penumbra
