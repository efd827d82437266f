// OpenGL contexts, with a window (GLFW) or offscreen (EGL), and their errors.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "core/error.hpp"

namespace penumbra {

enum class GlApi { gl33, gles30 };

struct GlInfo {
  GlApi api = GlApi::gl33;
  std::string renderer;
  std::string version;
  bool software = false;  // a CPU rasteriser: llvmpipe, softpipe, swrast
  // The context reports driver resets (GL_KHR_robustness). Otherwise a reset appears as another
  // error or ends the process.
  bool reports_resets = false;
};
[[nodiscard]] GlInfo current_gl_info(GlApi api);

// Returns the first OpenGL error since the previous call and clears the others; GL_CONTEXT_LOST if
// the driver was reset.
[[nodiscard]] std::optional<unsigned> take_gl_error(const GlInfo& context);
// Returns the message for a user: the cause and, if there is one, the remedy.
[[nodiscard]] std::string gl_error_text(unsigned code);

// Input in the window: a key, a mouse button, a finger (window systems report it as the left
// button), or a file that was dropped on it (one event per file).
struct WindowEvent {
  enum class Kind {
    key_down,
    key_up,
    button_down,
    button_up,
    pointer_moved,
    scrolled,
    text,
    file_dropped
  };
  static constexpr int kLeft = 0, kRight = 1, kMiddle = 2;  // buttons

  Kind kind = Kind::key_down;
  int code = 0;  // GLFW's code of the key or button; for text the Unicode code point
  bool shift = false, control = false, alt = false;
  // Pointer [px], from the top left corner of the window's framebuffer; scrolled: steps.
  double x = 0.0, y = 0.0;
  std::string file = {};  // path of the dropped file
};

class GlContext {
 public:
  GlContext() = default;
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;
  virtual ~GlContext() = default;

  virtual void make_current() = 0;
  [[nodiscard]] const GlInfo& info() const { return info_; }

  // The functions below are for windows; offscreen they do nothing.

  // Returns false once the user closed the window or its display was lost.
  [[nodiscard]] virtual bool poll_events() { return true; }
  // Returns true if the X server ended or another program destroyed the window. The context can
  // still draw into framebuffer objects.
  [[nodiscard]] virtual bool display_lost() const { return false; }
  virtual void swap() {}
  // Size of the window's framebuffer [px]; {0, 0} offscreen.
  struct Size {
    int width = 0;
    int height = 0;
  };
  [[nodiscard]] virtual Size window_size() const { return {}; }
  // poll_events() calls the handler.
  virtual void on_event(std::function<void(const WindowEvent&)> /*handler*/) {}
  virtual void toggle_full_screen() {}
  virtual void fill_screen() {}  // enters full screen, if the window is not in it
  // Ignores that the user closed the window: poll_events() returns true again.
  virtual void keep_open() {}
  virtual void show_pointer(bool /*shown*/) {}

 protected:
  GlInfo info_;
};

[[nodiscard]] Result<std::unique_ptr<GlContext>> create_offscreen_context(GlApi api = GlApi::gl33);

struct WindowOptions {
  int width = 640, height = 480;  // [px]; scaled down to the screen if it is smaller
  std::string title = "penumbra";
  GlApi api = GlApi::gl33;
  bool vsync = true;
  bool full_screen = false;
};
// Fails if there is no display.
[[nodiscard]] Result<std::unique_ptr<GlContext>> create_window_context(
    const WindowOptions& options);
[[nodiscard]] bool display_available();  // DISPLAY or WAYLAND_DISPLAY is set

}  // namespace penumbra
