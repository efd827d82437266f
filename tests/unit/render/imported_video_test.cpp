// Frames that the GPU reads from the camera's buffers equal copied frames bit for bit. Whether a
// pixel format is imported depends on the driver; Mesa's llvmpipe imports since 24.3.
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "core/image/frame.hpp"
#include "render/gl/imported_texture.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::RenderedImage;
using test::Studio;

// Memory that can be mapped several times, like a camera's buffer.
class SharedBuffer {
 public:
  SharedBuffer(std::size_t bytes, std::uint64_t number)
      : number_(number), size_(bytes), descriptor_(memfd_create("frame", MFD_CLOEXEC)) {
    if (descriptor_ < 0 || ftruncate(descriptor_, static_cast<off_t>(bytes)) != 0) std::abort();
    void* start = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, descriptor_, 0);
    if (start == MAP_FAILED) std::abort();
    bytes_ = static_cast<std::uint8_t*>(start);
  }
  SharedBuffer(const SharedBuffer&) = delete;
  SharedBuffer& operator=(const SharedBuffer&) = delete;
  ~SharedBuffer() {
    munmap(bytes_, size_);
    close(descriptor_);
  }
  // Copies the frame's pixels into this buffer.
  [[nodiscard]] Frame filled(const Frame& from) {
    Frame frame = from;
    const std::uint8_t* first = from.planes[0].data;
    for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
      PixelPlane& plane = frame.planes[i];
      const auto offset = static_cast<std::size_t>(plane.data - first);
      std::memcpy(bytes_ + offset, plane.data,
                  static_cast<std::size_t>(plane.stride) * static_cast<std::size_t>(plane.height));
      plane.data = bytes_ + offset;
      frame.dma_buf.offset[i] = offset;
    }
    frame.dma_buf.descriptor = descriptor_;
    frame.dma_buf.buffer = number_;
    frame.owner = std::make_shared<int>(0);
    return frame;
  }

 private:
  const std::uint64_t number_;
  const std::size_t size_;
  const int descriptor_;
  std::uint8_t* bytes_ = nullptr;
};

Frame noise(PixelFormat format, int width, int height, unsigned seed) {
  FrameBuffer buffer = allocate_frame(format, width, height);
  std::mt19937 random(seed);
  for (std::size_t i = 0; i < static_cast<std::size_t>(buffer.frame.plane_count); ++i) {
    const PixelPlane& plane = buffer.frame.planes[i];
    for (std::ptrdiff_t j = 0; j < plane.stride * plane.height; ++j) {
      buffer.plane_data[i][j] = static_cast<std::uint8_t>(random() & 0xFFU);
    }
  }
  return buffer.frame;
}

class ImportedVideo : public testing::TestWithParam<GlApi> {};

// A frame is uploaded for retextured shadows, and the CPU converts the next ones.
TEST_P(ImportedVideo, ReturnsBufferWhenCpuConvertsNextFrames) {
  test::SceneBuilder empty;
  Studio studio(empty.build(), test::camera_of(64, 48, 50.0), GetParam(),
                {.msaa = 0, .video_on_cpu = true});
  FramePlan retextured;
  retextured.translucency = Translucency::retexture;
  for (unsigned i = 0; i < 3; ++i) {
    SharedBuffer buffer(std::size_t{64} * 48 * 4, i);
    Frame shared = buffer.filled(noise(PixelFormat::nv12, 64, 48, i));
    studio.draw(shared, retextured);
    EXPECT_EQ(studio.stats()[Counter::draw_calls], 1) << "the shader draws the video";
    const std::weak_ptr<const void> owner = shared.owner;
    shared = noise(PixelFormat::nv12, 64, 48, 10 + i);
    studio.draw(shared, FramePlan());
    EXPECT_TRUE(owner.expired());
  }
}

TEST_P(ImportedVideo, MatchesCopiedVideoInEveryFormat) {
  constexpr int kWidth = 64, kHeight = 48;
  constexpr std::size_t kMaxBytes = std::size_t{kWidth} * kHeight * 4;
  for (const PixelFormat format : {PixelFormat::grey8, PixelFormat::rgb24, PixelFormat::yuyv,
                                   PixelFormat::nv12, PixelFormat::yuv420p, PixelFormat::yuv422p}) {
    test::SceneBuilder empty;
    Studio studio(empty.build(), test::camera_of(kWidth, kHeight, 50.0), GetParam(),
                  {.msaa = 0, .video_on_cpu = false});
    // Two buffers alternate, as a camera fills them; each is used three times.
    SharedBuffer first(kMaxBytes, 1), second(kMaxBytes, 2);
    std::int64_t imports = 0;
    for (unsigned i = 0; i < 6; ++i) {
      const Frame frame = noise(format, kWidth, kHeight, i);
      const RenderedImage copied = studio.draw(frame, FramePlan());
      EXPECT_EQ(studio.stats()[Counter::video_copies], 1);
      const Frame shared = (i % 2 == 0 ? first : second).filled(frame);
      const RenderedImage read = studio.draw(shared, FramePlan());
      EXPECT_EQ(studio.stats()[Counter::video_copies] + studio.stats()[Counter::video_imports], 1);
      imports += studio.stats()[Counter::video_imports];
      ASSERT_EQ(read.rgba, copied.rgba) << static_cast<int>(format) << " " << i;
      // An unchanged frame is neither copied nor imported again.
      EXPECT_EQ(studio.draw(shared, FramePlan()).rgba, copied.rgba);
      EXPECT_EQ(studio.stats()[Counter::video_copies] + studio.stats()[Counter::video_imports], 0);
    }
    // A driver imports either every frame of a pixel format or none. Frames that it does not import
    // (such as RGB) are copied.
    EXPECT_TRUE(imports == 0 || imports == 6) << imports;
    if (!can_import_textures()) {
      EXPECT_EQ(imports, 0);
    }
    RecordProperty(fmt::format("imports_{}", static_cast<int>(format)), static_cast<int>(imports));
  }
}

// A buffer returns to the camera only after the GPU has finished reading it. At the end of the
// test, all buffers have returned.
TEST_P(ImportedVideo, ReturnsBuffersWhenGpuIsDone) {
  constexpr int kWidth = 64, kHeight = 48;
  test::SceneBuilder empty;
  auto studio =
      std::make_unique<Studio>(empty.build(), test::camera_of(kWidth, kHeight, 50.0), GetParam());
  SharedBuffer buffer(std::size_t{kWidth} * kHeight * 4, 1);
  std::vector<std::weak_ptr<const void>> owners;
  for (unsigned i = 0; i < 10; ++i) {
    const Frame frame = buffer.filled(noise(PixelFormat::nv12, kWidth, kHeight, i));
    owners.push_back(frame.owner);
    studio->draw(frame, FramePlan());
    studio->draw(frame, FramePlan());
  }
  const auto held = std::count_if(owners.begin(), owners.end(),
                                  [](const auto& owner) { return !owner.expired(); });
  EXPECT_LE(held, 2);
  studio.reset();
  for (const auto& owner : owners) EXPECT_TRUE(owner.expired());
}

INSTANTIATE_TEST_SUITE_P(BothApis, ImportedVideo, testing::Values(GlApi::gl33, GlApi::gles30),
                         [](const auto& api) {
                           return api.param == GlApi::gl33 ? "OpenGl" : "OpenGlEs";
                         });

}  // namespace
}  // namespace penumbra
