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
};

class GlContext {
 public:
  GlContext() = default;
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;
  virtual ~GlContext() = default;

  virtual void make_current() = 0;
  [[nodiscard]] virtual const GlInfo& info() const = 0;
  // Window only: false once a person asked to close it. Offscreen: always true.
  [[nodiscard]] virtual bool poll_events() = 0;
  virtual void swap() = 0;
  // Size of the window's framebuffer [px]; {0, 0} offscreen.
  struct Size {
    int width = 0;
    int height = 0;
  };
  [[nodiscard]] virtual Size window_size() const = 0;
  // Called with GLFW's key code when a key goes down.
  virtual void on_key(std::function<void(int)> handler) = 0;
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
