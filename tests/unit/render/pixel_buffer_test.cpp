// Frames uploaded and read back through pixel buffers equal directly transferred frames bit for
// bit.
#include "render/gl/pixel_buffer.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "support/replaced_gl.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::RenderedImage;
using test::ReplacedGl;
using test::Studio;

CompositorOptions with_pixel_buffers(bool on) {
  CompositorOptions options{.msaa = 0, .video_on_cpu = false};  // uploads the video
  options.pixel_buffers = on;
  return options;
}

// Returns a frame of noise with `gap` bytes of padding at the end of each row.
Frame noise_of(PixelFormat format, int width, int height, int gap, unsigned seed) {
  FrameBuffer buffer = allocate_frame(format, width, height);
  Frame frame = buffer.frame;
  auto bytes = std::make_shared<std::vector<std::uint8_t>>();
  std::vector<std::size_t> starts;
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    PixelPlane& plane = frame.planes[i];
    plane.stride += gap;
    starts.push_back(bytes->size());
    bytes->resize(bytes->size() +
                  static_cast<std::size_t>(plane.stride) * static_cast<std::size_t>(plane.height));
  }
  std::mt19937 random(seed);
  for (std::uint8_t& byte : *bytes) byte = static_cast<std::uint8_t>(random() & 0xFFU);
  for (std::size_t i = 0; i < starts.size(); ++i) frame.planes[i].data = bytes->data() + starts[i];
  frame.owner = bytes;
  return frame;
}

Frame small_noise(unsigned seed) {
  return noise_of(PixelFormat::nv12, 64, 48, 0, seed);
}

class PixelBuffers : public testing::TestWithParam<GlApi> {
 protected:
  [[nodiscard]] std::unique_ptr<Studio> studio(int width, int height,
                                               const CompositorOptions& options) const {
    test::SceneBuilder empty;
    return std::make_unique<Studio>(empty.build(), test::camera_of(width, height, 50.0), GetParam(),
                                    options);
  }
};

TEST_P(PixelBuffers, UploadVideoUnchangedInEveryFormatSizeAndStride) {
  for (const auto& [width, height] : {std::pair{64, 48}, std::pair{37, 23}, std::pair{1, 1}}) {
    const auto direct = studio(width, height, with_pixel_buffers(false));
    const auto buffered = studio(width, height, with_pixel_buffers(true));
    EXPECT_FALSE(direct->compositor().pixel_buffers());
    EXPECT_TRUE(buffered->compositor().pixel_buffers());
    unsigned seed = 0;
    for (const PixelFormat format :
         {PixelFormat::grey8, PixelFormat::rgb24, PixelFormat::yuyv, PixelFormat::nv12,
          PixelFormat::yuv420p, PixelFormat::yuv422p, PixelFormat::yuv444p}) {
      // Uses more frames than the ring has buffers.
      for (const int gap : {0, 1, 2, 3, 5, 64}) {
        const Frame frame = noise_of(format, width, height, gap, ++seed);
        const RenderedImage expected = direct->draw(frame, FramePlan());
        EXPECT_EQ(direct->stats()[Counter::video_copies], 1);
        EXPECT_EQ(direct->stats()[Counter::pixel_buffer_uploads], 0);
        const RenderedImage uploaded = buffered->draw(frame, FramePlan());
        EXPECT_EQ(buffered->stats()[Counter::video_copies], 1);
        EXPECT_EQ(buffered->stats()[Counter::pixel_buffer_uploads], 1);
        ASSERT_EQ(uploaded.rgba, expected.rgba)
            << static_cast<int>(format) << " " << width << " " << gap;
      }
    }
  }
}

TEST_P(PixelBuffers, ReuseAndReportFrameAlreadyUploaded) {
  for (const bool on : {false, true}) {
    const auto shown = studio(64, 48, with_pixel_buffers(on));
    const Frame frame = small_noise(1);
    const RenderedImage first = shown->draw(frame, FramePlan());
    EXPECT_TRUE(shown->stats().kept.empty());
    EXPECT_EQ(shown->draw(frame, FramePlan()), first);
    EXPECT_EQ(shown->stats()[Counter::video_copies] + shown->stats()[Counter::pixel_buffer_uploads],
              0);
    ASSERT_EQ(shown->stats().kept.size(), 1U);
    EXPECT_EQ(shown->stats().kept[0].reason, KeepReason::video);
    FramePlan fresh;
    fresh.reuse = false;
    EXPECT_EQ(shown->draw(frame, fresh), first);
    EXPECT_TRUE(shown->stats().kept.empty());
    EXPECT_EQ(shown->stats()[Counter::pixel_buffer_uploads], on ? 1 : 0);
  }
}

TEST_P(PixelBuffers, FallBackToDirectUploadWhenDriverLosesBuffer) {
  const auto shown = studio(64, 48, with_pixel_buffers(true));
  const auto direct = studio(64, 48, with_pixel_buffers(false));
  shown->draw(small_noise(1), FramePlan());
  static decltype(epoxy_glUnmapBuffer) unmap = nullptr;
  unmap = epoxy_glUnmapBuffer;
  for (unsigned i = 2; i < 8; ++i) {
    const RenderedImage expected = direct->draw(small_noise(i), FramePlan());
    {
      const ReplacedGl loses(
          epoxy_glUnmapBuffer, +[](GLenum target) -> GLboolean {
            unmap(target);
            return GL_FALSE;
          });
      ASSERT_EQ(shown->draw(small_noise(i), FramePlan()), expected);
      EXPECT_EQ(shown->stats()[Counter::pixel_buffer_uploads], 0);
      EXPECT_EQ(shown->stats()[Counter::video_copies], 1);
    }
    {
      const ReplacedGl gives_none(
          epoxy_glMapBufferRange,
          +[](GLenum, GLintptr, GLsizeiptr, GLbitfield) -> void* { return nullptr; });
      ASSERT_EQ(shown->draw(small_noise(i), FramePlan()), expected);
      EXPECT_EQ(shown->stats()[Counter::pixel_buffer_uploads], 0);
    }
    ASSERT_EQ(shown->draw(small_noise(i), FramePlan()), expected);
    EXPECT_EQ(shown->stats()[Counter::pixel_buffer_uploads], 1);
  }
}

TEST_P(PixelBuffers, ReturnFramesInDrawingOrder) {
  for (const int samples : {0, 4}) {
    CompositorOptions options = with_pixel_buffers(true);
    options.msaa = samples;
    const auto shown = studio(37, 23, options);
    const auto direct = studio(37, 23, with_pixel_buffers(false));
    Compositor& compositor = shown->compositor();
    RenderedImage got{37, 23, std::vector<std::uint8_t>(std::size_t{4} * 37 * 23)};
    std::vector<RenderedImage> expected;
    for (unsigned i = 0; i < 7; ++i) {
      const Frame frame = noise_of(PixelFormat::yuv444p, 37, 23, 1, i);
      expected.push_back(direct->draw(frame, FramePlan()));
      // A screenshot reads the pending frame at once.
      ASSERT_EQ(shown->draw(frame, FramePlan()), expected.back());
      EXPECT_EQ(compositor.pending_images(), i > 0 ? 1U : 0U);
      const auto pending_reads = compositor.request_image();
      ASSERT_TRUE(pending_reads) << pending_reads.error().message;
      EXPECT_EQ((*pending_reads)[Counter::pixel_buffer_read_backs], 1);
      EXPECT_GT(pending_reads->readback_ms, 0.0);
      if (i == 0) continue;
      EXPECT_EQ(compositor.pending_images(), 2U);
      ASSERT_TRUE(compositor.take_image(got.rgba));
      ASSERT_EQ(got, expected[i - 1]) << i;
    }
    ASSERT_TRUE(compositor.take_image(got.rgba));
    EXPECT_EQ(got, expected.back());
    EXPECT_EQ(compositor.pending_images(), 0U);
  }
}

TEST_P(PixelBuffers, ReportLostFrameWithoutReplacingIt) {
  const auto shown = studio(64, 48, with_pixel_buffers(true));
  Compositor& compositor = shown->compositor();
  RenderedImage image = shown->draw(small_noise(1), FramePlan());
  ASSERT_TRUE(compositor.request_image());
  ASSERT_TRUE(compositor.take_image(image.rgba));
  static decltype(epoxy_glUnmapBuffer) unmap = nullptr;
  unmap = epoxy_glUnmapBuffer;
  ASSERT_TRUE(compositor.request_image());
  shown->draw(small_noise(2), FramePlan());
  ASSERT_TRUE(compositor.request_image());
  {
    const ReplacedGl loses(
        epoxy_glUnmapBuffer, +[](GLenum target) -> GLboolean {
          unmap(target);
          return GL_FALSE;
        });
    const auto result = compositor.take_image(image.rgba);
    ASSERT_FALSE(result);
    EXPECT_NE(result.error().message.find("--pixel-buffers off"), std::string::npos);
  }
  EXPECT_EQ(compositor.pending_images(), 0U);
  const RenderedImage expected = shown->draw(small_noise(3), FramePlan());
  ASSERT_TRUE(compositor.request_image());
  ASSERT_TRUE(compositor.take_image(image.rgba));
  EXPECT_EQ(image, expected);
}

// A CPU rasteriser draws into this process's memory, where a pixel buffer would only add a copy.
TEST_P(PixelBuffers, AreOffByDefaultOnSoftwareRenderers) {
  const auto shown = studio(64, 48, {});
  EXPECT_EQ(shown->compositor().pixel_buffers(), !shown->context().info().software);
  shown->draw(small_noise(1), FramePlan());
  EXPECT_EQ(shown->stats()[Counter::pixel_buffer_uploads],
            shown->context().info().software ? 0 : 1);
}

INSTANTIATE_TEST_SUITE_P(BothApis, PixelBuffers, testing::Values(GlApi::gl33, GlApi::gles30),
                         [](const auto& api) {
                           return api.param == GlApi::gl33 ? "OpenGl" : "OpenGlEs";
                         });

}  // namespace
}  // namespace penumbra
