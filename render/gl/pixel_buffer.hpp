// Buffers of pixels on their way to the GPU and back, so that neither it nor this process waits for
// the other. A loss where a CPU rasteriser draws: what they copy is copied once more.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/handle.hpp"

namespace penumbra {

// To the GPU: textures take a picture from here when the one before it is read no more.
class UploadBuffers {
 public:
  // So many bytes of the next buffer, to be written in full; whatever it held is gone, so that
  // nothing waits for who still reads that. Empty where the driver gives none.
  [[nodiscard]] std::span<std::uint8_t> map(std::size_t bytes);
  // What was written is there, and the buffer is bound for textures to take from until unbind().
  // False where the driver has lost it; nothing is bound then.
  [[nodiscard]] bool unmap();
  static void unbind();

 private:
  struct Buffer {
    GlHandle<BufferTraits> handle;  // none until it is needed
    std::size_t bytes = 0;
  };
  // One is written while another is taken from, and a driver may be behind by one more.
  std::array<Buffer, 3> buffers_;
  std::size_t next_ = 0;
};

// From the GPU: a picture that was asked for is had once the next one is being drawn.
class ReadBackBuffers {
 public:
  // At most so many pictures are on their way.
  static constexpr std::size_t kMost = 2;

  // The picture as it is now, width * height * 4 bytes.
  void ask(const Framebuffer& picture, std::size_t bytes);
  [[nodiscard]] std::size_t asked() const { return asked_; }
  // The one that was asked for first of those not taken; waits until it is drawn.
  [[nodiscard]] Result<void> take(std::span<std::uint8_t> rgba);
  // Not wanted any more: the one that was asked for last, or all.
  void drop_last();
  void drop_all() { asked_ = 0; }

 private:
  struct Buffer {
    GlHandle<BufferTraits> handle;
    std::size_t bytes = 0;
  };
  std::array<Buffer, kMost> buffers_;
  std::size_t first_ = 0, asked_ = 0;  // a ring
};

}  // namespace penumbra
