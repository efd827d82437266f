// Contexts with a window, through GLFW.
#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <cstdlib>

#include "render/gl/context.hpp"
#include "render/gl/context_info.hpp"

namespace penumbra {
namespace {

std::string last_glfw_error() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text != nullptr ? text : "no cause said";
}

class GlfwContext final : public GlContext {
 public:
  explicit GlfwContext(GLFWwindow* window) : window_(window) {
    glfwSetWindowUserPointer(window_, this);
    glfwSetKeyCallback(window_, [](GLFWwindow* w, int key, int, int action, int) {
      auto* self = static_cast<GlfwContext*>(glfwGetWindowUserPointer(w));
      if (action == GLFW_PRESS && self->on_key_) self->on_key_(key);
    });
  }
  GlfwContext(const GlfwContext&) = delete;
  GlfwContext& operator=(const GlfwContext&) = delete;
  ~GlfwContext() override {
    glfwDestroyWindow(window_);
    glfwTerminate();
  }

  void read_info(GlApi api) { info_ = current_gl_info(api); }

  void make_current() override { glfwMakeContextCurrent(window_); }
  [[nodiscard]] const GlInfo& info() const override { return info_; }
  [[nodiscard]] bool poll_events() override {
    glfwPollEvents();
    return glfwWindowShouldClose(window_) == GLFW_FALSE;
  }
  void swap() override { glfwSwapBuffers(window_); }
  [[nodiscard]] Size window_size() const override {
    Size size;
    glfwGetFramebufferSize(window_, &size.width, &size.height);
    return size;
  }
  void on_key(std::function<void(int)> handler) override { on_key_ = std::move(handler); }

 private:
  GLFWwindow* window_;
  GlInfo info_;
  std::function<void(int)> on_key_;
};

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
  if (glfwInit() != GLFW_TRUE) {
    return fail("no window: {}; check DISPLAY, or run without a window", last_glfw_error());
  }
  glfwDefaultWindowHints();
  if (options.api == GlApi::gl33) {
    glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
    glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
    glfwWindowHint(GLFW_OPENGL_FORWARD_COMPAT, GLFW_TRUE);
  } else {
    glfwWindowHint(GLFW_CLIENT_API, GLFW_OPENGL_ES_API);
    glfwWindowHint(GLFW_CONTEXT_CREATION_API, GLFW_EGL_CONTEXT_API);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 0);
  }
  // The picture is drawn into a framebuffer of its own and copied over: the window needs colour
  // only.
  glfwWindowHint(GLFW_DEPTH_BITS, 0);
  glfwWindowHint(GLFW_STENCIL_BITS, 0);
  GLFWwindow* window =
      glfwCreateWindow(options.width, options.height, options.title.c_str(), nullptr, nullptr);
  if (window == nullptr) {
    const std::string cause = last_glfw_error();
    glfwTerminate();
    return fail("no window: {}; the driver must offer {}", cause,
                options.api == GlApi::gl33 ? "OpenGL 3.3 core" : "OpenGL ES 3.0");
  }
  auto context = std::make_unique<GlfwContext>(window);
  context->make_current();
  glfwSwapInterval(options.vsync ? 1 : 0);
  context->read_info(options.api);
  return context;
}

}  // namespace penumbra
