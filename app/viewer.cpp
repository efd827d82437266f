#include "app/viewer.hpp"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <chrono>
#include <thread>

#include "core/stopwatch.hpp"

namespace penumbra {

Viewer::Viewer(GlContext& context) : context_(context) {
  context_.on_key([this](int key) {
    if (key == GLFW_KEY_ESCAPE || key == GLFW_KEY_Q) closed_ = true;
    if (key == GLFW_KEY_SPACE) paused_ = !paused_;
  });
}

Viewer::~Viewer() {
  context_.on_key({});
}

bool Viewer::show(const std::function<void()>& present, InterruptWatch& interrupt) {
  // While paused the picture is drawn again at an easy rate: the window may be resized or
  // uncovered.
  constexpr std::chrono::milliseconds kPausedRefresh(30);
  const Stopwatch pause;
  bool waited = false;
  do {
    present();
    context_.swap();
    if (!context_.poll_events()) closed_ = true;
    if (paused_ && !closed_) {
      waited = true;
      std::this_thread::sleep_for(kPausedRefresh);
    }
  } while (paused_ && !closed_ && !interrupt.interrupted());
  if (waited) paused_ms_ += pause.elapsed().wall_ms;
  return !closed_;
}

}  // namespace penumbra
