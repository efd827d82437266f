#include "render/gl/x11_connection.hpp"

#include <X11/Xlib.h>
#include <dlfcn.h>

#include <atomic>

namespace penumbra {
namespace {

struct Watched {
  std::atomic<bool> lost = false;
  std::atomic<XID> window = 0;
};

// Global state, because Xlib's handlers have no user data.
Watched& watched() {
  static Watched state;
  return state;
}

// Looks up a function that Wayland-only builds of GLFW lack.
template <class Function>
Function* glfw_function(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_DEFAULT, name));
}

int remember_loss(Display* /*display*/) {
  watched().lost = true;
  return 0;
}

// Xlib's default handler would end the process; after this handler, Xlib's functions fail instead.
void go_on(Display* /*display*/, void* /*data*/) {}

int ignore_but_loss(Display* /*display*/, XErrorEvent* error) {
  const bool gone = error->error_code == BadWindow || error->error_code == BadDrawable;
  if (gone && error->resourceid != 0 && error->resourceid == watched().window) {
    watched().lost = true;
  }
  return 0;
}

}  // namespace

void watch_x11_connection() {
  auto* get_display = glfw_function<Display*()>("glfwGetX11Display");
  Display* display = get_display != nullptr ? get_display() : nullptr;
  if (display == nullptr) return;
  XSetIOErrorHandler(&remember_loss);
  XSetIOErrorExitHandler(display, &go_on, nullptr);
  XSetErrorHandler(&ignore_but_loss);
}

void watch_x11_window(GLFWwindow* window) {
  auto* get_window = glfw_function<Window(GLFWwindow*)>("glfwGetX11Window");
  watched().window = get_window != nullptr ? get_window(window) : 0;
}

bool x11_connection_lost() {
  return watched().lost;
}

}  // namespace penumbra
