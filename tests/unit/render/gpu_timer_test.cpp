// Each frame's GPU time is reported once, some frames later, without blocking.
#include "render/gl/gpu_timer.hpp"

#include <gtest/gtest.h>

#include <optional>

#include "render/gl/framebuffer.hpp"
#include "support/replaced_gl.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::ReplacedGl;
using test::Studio;

class GpuTime : public testing::TestWithParam<GlApi> {
 protected:
  GpuTime()
      : context(create_offscreen_context(GetParam()).value()),
        framebuffer(Framebuffer::create(160, 120).value()),
        timer(GpuTimer::create(GetParam())) {}
  // Makes the context current, since a test may have changed it.
  ~GpuTime() override { context->make_current(); }
  // Measures one frame as the compositor does. Returns the number of earlier frames whose times
  // arrived.
  std::size_t draw() {
    const std::size_t arrived = take();
    timer->begin();
    framebuffer.clear();
    timer->end();
    glFinish();
    return arrived;
  }
  std::size_t take() {
    std::vector<double> times_ms;
    timer->take(times_ms);
    for (const double time_ms : times_ms) EXPECT_GT(time_ms, 0.0);
    return times_ms.size();
  }
  std::size_t drain() {
    glFinish();
    return take();
  }
  // Returns true if the driver has timer queries, which OpenGL 3.3 requires.
  [[nodiscard]] bool measured() const {
    EXPECT_TRUE(timer || GetParam() == GlApi::gles30);
    return timer.has_value();
  }

  std::unique_ptr<GlContext> context;
  Framebuffer framebuffer;
  std::optional<GpuTimer> timer;
};

TEST_P(GpuTime, IsReportedOncePerFrameWithBoundedDelay) {
  if (!measured()) GTEST_SKIP() << "the driver has no GL_EXT_disjoint_timer_query";
  constexpr std::size_t kFrames = 40;
  std::size_t reported = 0;
  for (std::size_t drawn = 0; drawn < kFrames; ++drawn) {
    reported += draw();
    EXPECT_LE(reported, drawn) << "only earlier frames are reported";
    EXPECT_GE(reported + GpuTimer::kMaxPending, drawn);
  }
  EXPECT_EQ(reported + drain(), kFrames);
  EXPECT_EQ(drain(), 0U);
}

// If the GPU lags far behind, no query is free for some frames, and these frames are not measured.
// All other frames are reported once.
TEST_P(GpuTime, IsReadLaterWithoutBlocking) {
  if (!measured()) GTEST_SKIP() << "the driver has no GL_EXT_disjoint_timer_query";
  draw();
  draw();
  drain();
  static decltype(epoxy_glGetQueryObjectuiv) query = nullptr;
  query = epoxy_glGetQueryObjectuiv;
  {
    const ReplacedGl late(
        epoxy_glGetQueryObjectuiv, +[](GLuint id, GLenum what, GLuint* value) {
          query(id, what, value);
          if (what == GL_QUERY_RESULT_AVAILABLE) *value = GL_FALSE;
        });
    for (std::size_t i = 0; i < 2 * GpuTimer::kMaxPending; ++i) EXPECT_EQ(draw(), 0U);
  }
  EXPECT_EQ(draw(), GpuTimer::kMaxPending);
  EXPECT_EQ(drain(), 1U);
}

TEST_P(GpuTime, ExcludesWarmUpDraws) {
  if (!measured()) GTEST_SKIP() << "the driver has no GL_EXT_disjoint_timer_query";
  draw();
  timer->drop_pending();
  EXPECT_EQ(draw(), 0U);
  EXPECT_EQ(drain(), 1U);
}

// Only OpenGL ES reports disjoint GPU time.
class DisjointGpuTime : public GpuTime {};

TEST_P(DisjointGpuTime, IsDiscarded) {
  if (!measured()) GTEST_SKIP() << "the driver has no GL_EXT_disjoint_timer_query";
  draw();
  draw();
  drain();
  draw();
  glFinish();
  static decltype(epoxy_glGetIntegerv) get = nullptr;
  get = epoxy_glGetIntegerv;
  {
    const ReplacedGl uneven(
        epoxy_glGetIntegerv, +[](GLenum name, GLint* value) {
          get(name, value);
          if (name == GL_GPU_DISJOINT_EXT) *value = 1;
        });
    EXPECT_EQ(draw(), 0U);  // the previous frame's time is discarded too
  }
  EXPECT_EQ(draw(), 1U) << "this frame began after the disjoint check";
  EXPECT_EQ(drain(), 1U);
}

// On a CPU rasteriser, drawing time is already part of a timed CPU stage.
TEST_P(GpuTime, IsOffByDefaultOnSoftwareRenderers) {
  test::SceneBuilder empty;
  Studio shown(empty.build(), test::camera_of(64, 48, 50.0), GetParam());
  if (!shown.context().info().software) GTEST_SKIP() << "the renderer is a GPU";
  std::size_t reported = 0;
  for (int i = 0; i < 10; ++i) {
    shown.draw(test::plain_frame(64, 48, 90), FramePlan());
    reported += shown.stats().gpu_ms.size();
  }
  glFinish();
  EXPECT_EQ(reported + shown.compositor().take_gpu_times().size(), 0U);
}

INSTANTIATE_TEST_SUITE_P(Apis, DisjointGpuTime, testing::Values(GlApi::gles30),
                         [](const auto&) { return "OpenGlEs"; });
INSTANTIATE_TEST_SUITE_P(BothApis, GpuTime, testing::Values(GlApi::gl33, GlApi::gles30),
                         [](const auto& api) {
                           return api.param == GlApi::gl33 ? "OpenGl" : "OpenGlEs";
                         });

}  // namespace
}  // namespace penumbra
