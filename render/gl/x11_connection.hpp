// The connection to the X server, which may end while a window is open.
#pragma once

struct GLFWwindow;

namespace penumbra {

// Remembers the loss of the X server instead of ending the process, as Xlib does by default. Call
// it after glfwInit(). Other errors of X requests are ignored. Does nothing on Wayland.
void watch_x11_connection();
// Treats the window's destruction by another program as a loss too.
void watch_x11_window(GLFWwindow* window);
// Once true, functions of GLFW and Xlib that use the display must not be called.
[[nodiscard]] bool x11_connection_lost();

}  // namespace penumbra
