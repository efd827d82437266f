// Handles the loss of the connection to the X server while a window is open.
#pragma once

struct GLFWwindow;

namespace penumbra {

// Records the loss of the X server; Xlib's default handler would end the process. Call it after
// glfwInit(). Ignores other errors of X requests. Has no effect on Wayland.
void watch_x11_connection();
// Treats destruction of the window by another program as a loss of the connection.
void watch_x11_window(GLFWwindow* window);
// If true, functions of GLFW and Xlib that use the display must not be called any more.
[[nodiscard]] bool x11_connection_lost();

}  // namespace penumbra
