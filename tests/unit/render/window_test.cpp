// Opens a window if there is a display (a desktop, or tests/support/with-display); otherwise checks
// the reported error.
#include <dlfcn.h>
#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdlib>

#include "support/studio.hpp"

namespace {

bool refuses_reset_notification = false;
int requested_robustness = 0;
int windows_refused = 0;

template <class Function>
Function* glfw_function(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

}  // namespace

// Replaces GLFW's function to simulate a driver without reset notification.
extern "C" void glfwWindowHint(int hint, int value) {
  if (hint == GLFW_CONTEXT_ROBUSTNESS) requested_robustness = value;
  glfw_function<decltype(glfwWindowHint)>("glfwWindowHint")(hint, value);
}
extern "C" GLFWwindow* glfwCreateWindow(int width, int height, const char* title,
                                        GLFWmonitor* monitor, GLFWwindow* share) {
  if (refuses_reset_notification && requested_robustness == GLFW_LOSE_CONTEXT_ON_RESET) {
    ++windows_refused;
    return nullptr;
  }
  return glfw_function<decltype(glfwCreateWindow)>("glfwCreateWindow")(width, height, title,
                                                                       monitor, share);
}

namespace penumbra {
namespace {

TEST(Window, ReportsOneLineErrorWithoutDisplay) {
  if (display_available()) GTEST_SKIP() << "a display is available";
  const auto window = create_window_context({});
  ASSERT_FALSE(window);
  EXPECT_THAT(window.error().message, testing::HasSubstr("DISPLAY"));
  EXPECT_THAT(window.error().message, testing::Not(testing::HasSubstr("\n")));
}

TEST(Window, ShowsFrameUprightAndLetterboxed) {
  if (!display_available()) GTEST_SKIP() << "no display: DISPLAY and WAYLAND_DISPLAY are not set";
  WindowOptions options;
  options.width = 300;
  options.height = 240;
  options.vsync = false;
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    options.api = api;
    auto context = create_window_context(options);
    ASSERT_TRUE(context) << context.error().message;
    const GlContext::Size size = (*context)->window_size();
    const CameraModel camera = test::camera_of(150, 100, 100.0);
    auto compositor = Compositor::create(**context, test::SceneBuilder().build(), camera).value();
    FrameBuffer frame = allocate_frame(PixelFormat::grey8, 150, 100);
    for (int y = 0; y < 100; ++y) {
      for (int x = 0; x < 150; ++x) {
        frame.plane_data[0][y * frame.frame.planes[0].stride + x] =
            static_cast<std::uint8_t>(y < 50 ? (x < 75 ? 250 : 200) : (x < 75 ? 150 : 100));
      }
    }
    ASSERT_TRUE(compositor.draw(frame.frame, FramePlan()));
    compositor.present();
    ASSERT_EQ(size.width, 300);
    ASSERT_EQ(size.height, 240);
    // The frame fills 300 x 200 of 300 x 240 px, with 20 black rows above and below it. Row 0 of a
    // window is the lowest row.
    const auto value = [](int x, int y_from_bottom) {
      std::array<std::uint8_t, 4> pixel{};
      glBindFramebuffer(GL_READ_FRAMEBUFFER, 0);
      glReadPixels(x, y_from_bottom, 1, 1, GL_RGBA, GL_UNSIGNED_BYTE, pixel.data());
      return static_cast<int>(pixel[0]);
    };
    EXPECT_EQ(value(30, 235), 0);
    EXPECT_EQ(value(30, 5), 0);
    EXPECT_EQ(value(30, 200), 250);
    EXPECT_EQ(value(270, 200), 200);
    EXPECT_EQ(value(30, 40), 150);
    EXPECT_EQ(value(270, 40), 100);
    (*context)->swap();
    EXPECT_TRUE((*context)->poll_events());
  }
}

TEST(Window, ShowsFrameWhenDriverLacksResetNotification) {
  if (!display_available()) GTEST_SKIP() << "no display: DISPLAY and WAYLAND_DISPLAY are not set";
  WindowOptions options;
  options.vsync = false;
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    options.api = api;
    windows_refused = 0;
    refuses_reset_notification = true;
    const auto context = create_window_context(options);
    refuses_reset_notification = false;
    ASSERT_TRUE(context) << context.error().message;
    EXPECT_EQ(windows_refused, 1) << "the first request includes reset notification";
    EXPECT_FALSE((*context)->info().reports_resets);
    auto compositor =
        Compositor::create(**context, test::SceneBuilder().build(), test::camera_of(64, 48, 50.0));
    ASSERT_TRUE(compositor) << compositor.error().message;
    const auto drawn = compositor->draw(test::plain_frame(64, 48, 90), FramePlan());
    EXPECT_TRUE(drawn) << drawn.error().message;
    compositor->present();
    (*context)->swap();
  }
}

}  // namespace
}  // namespace penumbra
