// The window: shows each picture; Esc or q closes, space pauses.
#pragma once

#include <memory>

#include "app/interrupt.hpp"
#include "app/session.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

class Viewer {
 public:
  // `context` has a window and outlives the viewer.
  explicit Viewer(GlContext& context);
  Viewer(const Viewer&) = delete;
  Viewer& operator=(const Viewer&) = delete;
  ~Viewer();

  // Shows the session's last picture and answers keys, while paused until that ends. False once
  // the window was closed (or the program interrupted).
  [[nodiscard]] bool show(Session& session, InterruptWatch& interrupt);
  // How long the pauses were, all together [ms]: time that does not count for pacing.
  [[nodiscard]] double paused_ms() const { return paused_ms_; }

 private:
  GlContext& context_;
  bool paused_ = false;
  bool closed_ = false;
  double paused_ms_ = 0.0;
};

}  // namespace penumbra
