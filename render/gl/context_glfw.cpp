// Contexts with a window, through GLFW.
#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <algorithm>
#include <cstdlib>

#include "render/gl/context.hpp"
#include "render/gl/x11_connection.hpp"

namespace penumbra {
namespace {

std::string last_glfw_error() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text != nullptr ? text : "no cause given";
}

class GlfwContext final : public GlContext {
 public:
  explicit GlfwContext(GLFWwindow* window) : window_(window) {
    watch_x11_window(window);
    glfwSetWindowUserPointer(window_, this);
    glfwSetKeyCallback(window_, [](GLFWwindow* w, int key, int, int action, int modifiers) {
      if (action == GLFW_REPEAT) return;
      emit(w, action == GLFW_PRESS ? Kind::key_down : Kind::key_up, key, modifiers);
    });
    glfwSetMouseButtonCallback(window_, [](GLFWwindow* w, int button, int action, int modifiers) {
      emit(w, action == GLFW_PRESS ? Kind::button_down : Kind::button_up, button, modifiers);
    });
    glfwSetCursorPosCallback(window_, [](GLFWwindow* w, double, double) {
      emit(w, Kind::pointer_moved, 0, current_modifiers(w));
    });
    glfwSetScrollCallback(window_, [](GLFWwindow* w, double x, double y) {
      WindowEvent event;
      event.kind = Kind::scrolled;
      event.x = x;
      event.y = y;
      pass_on(w, event);
    });
    glfwSetDropCallback(window_, [](GLFWwindow* w, int count, const char** files) {
      for (int i = 0; i < count; ++i) {
        WindowEvent event;
        event.kind = Kind::file_dropped;
        event.file = files[i];
        pass_on(w, event);
      }
    });
    glfwSetCharCallback(window_, [](GLFWwindow* w, unsigned code) {
      emit(w, Kind::text, static_cast<int>(code), 0);
    });
  }
  ~GlfwContext() override {
    if (x11_connection_lost()) return;
    glfwDestroyWindow(window_);
    glfwTerminate();
  }

  void read_info(GlApi api) { info_ = current_gl_info(api); }

  void make_current() override {
    if (!x11_connection_lost()) glfwMakeContextCurrent(window_);
  }
  [[nodiscard]] bool poll_events() override {
    if (!x11_connection_lost()) glfwPollEvents();
    return !x11_connection_lost() && glfwWindowShouldClose(window_) == GLFW_FALSE;
  }
  [[nodiscard]] bool display_lost() const override { return x11_connection_lost(); }
  void swap() override {
    if (!x11_connection_lost()) glfwSwapBuffers(window_);
  }
  [[nodiscard]] Size window_size() const override {
    if (x11_connection_lost()) return last_size_;
    Size size;
    glfwGetFramebufferSize(window_, &size.width, &size.height);
    // GLFW returns undefined values if the display is lost during the call.
    if (!x11_connection_lost()) last_size_ = size;
    return last_size_;
  }
  void on_event(std::function<void(const WindowEvent&)> handler) override {
    on_event_ = std::move(handler);
  }
  void keep_open() override {
    if (!x11_connection_lost()) glfwSetWindowShouldClose(window_, GLFW_FALSE);
  }
  void show_pointer(bool shown) override {
    if (x11_connection_lost()) return;
    glfwSetInputMode(window_, GLFW_CURSOR, shown ? GLFW_CURSOR_NORMAL : GLFW_CURSOR_HIDDEN);
  }
  void fill_screen() override {
    if (!x11_connection_lost() && glfwGetWindowMonitor(window_) == nullptr) toggle_full_screen();
  }
  void toggle_full_screen() override {
    if (x11_connection_lost()) return;
    if (glfwGetWindowMonitor(window_) != nullptr) {
      glfwSetWindowMonitor(window_, nullptr, at_x_, at_y_, at_width_, at_height_, GLFW_DONT_CARE);
      return;
    }
    GLFWmonitor* monitor = glfwGetPrimaryMonitor();
    const GLFWvidmode* mode = monitor != nullptr ? glfwGetVideoMode(monitor) : nullptr;
    if (mode == nullptr) return;
    glfwGetWindowPos(window_, &at_x_, &at_y_);
    glfwGetWindowSize(window_, &at_width_, &at_height_);
    glfwSetWindowMonitor(window_, monitor, 0, 0, mode->width, mode->height, mode->refreshRate);
  }

 private:
  using Kind = WindowEvent::Kind;

  static int current_modifiers(GLFWwindow* window) {
    const auto down = [window](int left, int right) {
      return glfwGetKey(window, left) == GLFW_PRESS || glfwGetKey(window, right) == GLFW_PRESS;
    };
    return (down(GLFW_KEY_LEFT_SHIFT, GLFW_KEY_RIGHT_SHIFT) ? GLFW_MOD_SHIFT : 0) |
           (down(GLFW_KEY_LEFT_CONTROL, GLFW_KEY_RIGHT_CONTROL) ? GLFW_MOD_CONTROL : 0) |
           (down(GLFW_KEY_LEFT_ALT, GLFW_KEY_RIGHT_ALT) ? GLFW_MOD_ALT : 0);
  }
  static void pass_on(GLFWwindow* window, const WindowEvent& event) {
    const auto* self = static_cast<GlfwContext*>(glfwGetWindowUserPointer(window));
    if (self->on_event_) self->on_event_(event);
  }
  // Sends an event with the pointer's position.
  static void emit(GLFWwindow* window, Kind kind, int code, int modifiers) {
    WindowEvent event;
    event.kind = kind;
    event.code = code;
    event.shift = (modifiers & GLFW_MOD_SHIFT) != 0;
    event.control = (modifiers & GLFW_MOD_CONTROL) != 0;
    event.alt = (modifiers & GLFW_MOD_ALT) != 0;
    glfwGetCursorPos(window, &event.x, &event.y);
    // Converts screen coordinates to pixels.
    int width = 0, height = 0, width_px = 0, height_px = 0;
    glfwGetWindowSize(window, &width, &height);
    glfwGetFramebufferSize(window, &width_px, &height_px);
    if (width > 0 && height > 0) {
      event.x *= static_cast<double>(width_px) / width;
      event.y *= static_cast<double>(height_px) / height;
    }
    if (!x11_connection_lost()) pass_on(window, event);
  }

  GLFWwindow* window_;
  mutable Size last_size_;
  std::function<void(const WindowEvent&)> on_event_;
  // The window's area before it became full-screen.
  int at_x_ = 0, at_y_ = 0, at_width_ = 640, at_height_ = 480;
};

// Returns the factor, at most 1, with which the window fits the screen without panels.
double scale_to_screen(const WindowOptions& options) {
  GLFWmonitor* monitor = glfwGetPrimaryMonitor();
  if (monitor == nullptr) return 1.0;
  int x = 0, y = 0, width = 0, height = 0;
  glfwGetMonitorWorkarea(monitor, &x, &y, &width, &height);
  if (width <= 0 || height <= 0) return 1.0;
  return std::min({1.0, static_cast<double>(width) / options.width,
                   static_cast<double>(height) / options.height});
}

}  // namespace

bool display_available() {
  const auto set = [](const char* name) {
    const char* value = std::getenv(name);
    return value != nullptr && *value != '\0';
  };
  return set("DISPLAY") || set("WAYLAND_DISPLAY");
}

Result<std::unique_ptr<GlContext>> create_window_context(const WindowOptions& options) {
  if (!display_available()) {
    return fail(
        "no window: neither DISPLAY nor WAYLAND_DISPLAY is set; run in a desktop session, under "
        "xvfb-run, or without a window");
  }
  if (x11_connection_lost()) return fail("no window: the connection to the display was lost");
  if (glfwInit() != GLFW_TRUE) {
    return fail("no window: {}; check DISPLAY, or run without a window", last_glfw_error());
  }
  watch_x11_connection();
  glfwDefaultWindowHints();
  const bool desktop = options.api == GlApi::gl33;
  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, desktop ? 3 : 0);
  if (desktop) {
    glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
    glfwWindowHint(GLFW_OPENGL_FORWARD_COMPAT, GLFW_TRUE);
  } else {
    glfwWindowHint(GLFW_CLIENT_API, GLFW_OPENGL_ES_API);
    glfwWindowHint(GLFW_CONTEXT_CREATION_API, GLFW_EGL_CONTEXT_API);
  }
  // Images are copied from framebuffer objects, so the window needs no depth and stencil.
  glfwWindowHint(GLFW_DEPTH_BITS, 0);
  glfwWindowHint(GLFW_STENCIL_BITS, 0);
  // A full-screen window stays when another window takes the focus.
  glfwWindowHint(GLFW_AUTO_ICONIFY, GLFW_FALSE);
  const double fit = scale_to_screen(options);
  const auto create = [&](int robustness) {
    glfwWindowHint(GLFW_CONTEXT_ROBUSTNESS, robustness);
    return glfwCreateWindow(std::max(1, static_cast<int>(fit * options.width)),
                            std::max(1, static_cast<int>(fit * options.height)),
                            options.title.c_str(), nullptr, nullptr);
  };
  // Enables reports of driver resets, if the driver supports them.
  GLFWwindow* window = create(GLFW_LOSE_CONTEXT_ON_RESET);
  if (window == nullptr) window = create(GLFW_NO_ROBUSTNESS);
  if (window == nullptr) {
    const std::string cause = last_glfw_error();
    if (!x11_connection_lost()) glfwTerminate();
    return fail("no window: {}; the driver must offer {}", cause,
                options.api == GlApi::gl33 ? "OpenGL 3.3 core" : "OpenGL ES 3.0");
  }
  auto context = std::make_unique<GlfwContext>(window);
  context->make_current();
  glfwSwapInterval(options.vsync ? 1 : 0);
  context->read_info(options.api);
  if (options.full_screen) context->toggle_full_screen();
  return context;
}

}  // namespace penumbra
