// The window: shows each picture; Esc or q closes, space pauses.
#pragma once

#include <functional>

#include "app/interrupt.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

class Viewer {
 public:
  // `context` has a window and outlives the viewer.
  explicit Viewer(GlContext& context);
  Viewer(const Viewer&) = delete;
  Viewer& operator=(const Viewer&) = delete;
  ~Viewer();

  // Shows a picture, which `present` draws into the window, and answers keys; while paused until
  // that ends or the program is interrupted. False once the window was closed.
  [[nodiscard]] bool show(const std::function<void()>& present, InterruptWatch& interrupt);
  // How long the pauses were, all together [ms]: time that does not count for pacing.
  [[nodiscard]] double paused_ms() const { return paused_ms_; }

 private:
  GlContext& context_;
  bool paused_ = false;
  bool closed_ = false;
  double paused_ms_ = 0.0;
};

}  // namespace penumbra
