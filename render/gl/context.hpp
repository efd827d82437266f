// An OpenGL context: a window (GLFW) or none at all (EGL, Mesa's surfaceless platform where there
// is no GPU).
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "core/error.hpp"

namespace penumbra {

enum class GlApi { gl33, gles30 };

struct GlInfo {
  GlApi api = GlApi::gl33;
  std::string renderer;
  std::string version;
  bool software = false;  // a CPU rasteriser: llvmpipe, softpipe, swrast
  // The driver says when it was reset (GL_KHR_robustness, and the context asked for it); without
  // that a reset is another error, or the end of the process.
  bool tells_resets = false;
};

// What a person did in the window: a key, the mouse, or a finger (which window systems pass on as
// the left button).
struct WindowEvent {
  enum class Kind { key_down, key_up, button_down, button_up, pointer_moved, scrolled, text };
  static constexpr int kLeft = 0, kRight = 1, kMiddle = 2;  // buttons

  Kind kind = Kind::key_down;
  int code = 0;  // GLFW's of the key or button; of text: the Unicode code point
  bool shift = false, control = false, alt = false;
  // The pointer, in pixels of the window's framebuffer from its top left corner; scrolled: steps.
  double x = 0.0, y = 0.0;
};

class GlContext {
 public:
  GlContext() = default;
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;
  virtual ~GlContext() = default;

  virtual void make_current() = 0;
  [[nodiscard]] virtual const GlInfo& info() const = 0;
  // Window only: false once a person asked to close it or its display was lost. Offscreen: always
  // true.
  [[nodiscard]] virtual bool poll_events() = 0;
  // Window only: the X server ended, or another program destroyed the window. The context still
  // draws into framebuffer objects.
  [[nodiscard]] virtual bool display_lost() const { return false; }
  virtual void swap() = 0;
  // Size of the window's framebuffer [px]; {0, 0} offscreen.
  struct Size {
    int width = 0;
    int height = 0;
  };
  [[nodiscard]] virtual Size window_size() const = 0;
  // Called from poll_events().
  virtual void on_event(std::function<void(const WindowEvent&)> handler) = 0;
  // To the whole of the screen and back. Offscreen: nothing.
  virtual void toggle_full_screen() = 0;
};

[[nodiscard]] Result<std::unique_ptr<GlContext>> create_offscreen_context(GlApi api = GlApi::gl33);

struct WindowOptions {
  int width = 640, height = 480;  // [px]
  std::string title = "penumbra";
  GlApi api = GlApi::gl33;
  bool vsync = true;
};
// Fails in one line where there is no display.
[[nodiscard]] Result<std::unique_ptr<GlContext>> create_window_context(
    const WindowOptions& options);
[[nodiscard]] bool display_available();  // DISPLAY or WAYLAND_DISPLAY is set

}  // namespace penumbra
