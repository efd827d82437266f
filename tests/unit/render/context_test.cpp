// A context is created even if the driver has no reset notification, and the context reports that.
#include "render/gl/context.hpp"

#include <epoxy/egl.h>
#include <gtest/gtest.h>

#include "render/compositor.hpp"
#include "support/replaced_gl.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::ReplacedGl;

decltype(epoxy_eglCreateContext) create_context = nullptr;
int refused = 0;

bool asks_for_reset_notification(const EGLint* attributes) {
  for (; attributes != nullptr && attributes[0] != EGL_NONE; attributes += 2) {
    if (attributes[0] == EGL_CONTEXT_OPENGL_RESET_NOTIFICATION_STRATEGY ||
        attributes[0] == EGL_CONTEXT_OPENGL_RESET_NOTIFICATION_STRATEGY_EXT) {
      return attributes[1] == EGL_LOSE_CONTEXT_ON_RESET;
    }
  }
  return false;
}

EGLContext create_without_notification(EGLDisplay display, EGLConfig config, EGLContext shared,
                                       const EGLint* attributes) {
  if (!asks_for_reset_notification(attributes)) {
    return create_context(display, config, shared, attributes);
  }
  ++refused;
  return EGL_NO_CONTEXT;
}

TEST(OffscreenContext, IsCreatedWithoutResetNotification) {
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    const auto usual = create_offscreen_context(api);
    ASSERT_TRUE(usual) << usual.error().message;
    EXPECT_TRUE((*usual)->info().reports_resets || !(*usual)->info().software)
        << "Mesa's software rasterisers report resets";
    create_context = epoxy_eglCreateContext;
    refused = 0;
    const ReplacedGl refuses(epoxy_eglCreateContext, create_without_notification);
    const auto context = create_offscreen_context(api);
    ASSERT_TRUE(context) << context.error().message;
    EXPECT_EQ(refused, (*usual)->info().reports_resets ? 1 : refused);
    EXPECT_FALSE((*context)->info().reports_resets);
    EXPECT_EQ((*context)->info().renderer, (*usual)->info().renderer);
    EXPECT_EQ((*context)->info().version, (*usual)->info().version);
    // The compositor works in this context, because the compositor needs no reset notification.
    auto compositor =
        Compositor::create(**context, test::SceneBuilder().build(), test::camera_of(64, 48, 50.0));
    ASSERT_TRUE(compositor) << compositor.error().message;
    const auto drawn = compositor->draw(test::plain_frame(64, 48, 90), FramePlan());
    EXPECT_TRUE(drawn) << drawn.error().message;
  }
}

}  // namespace
}  // namespace penumbra
