// Pixel buffers for asynchronous transfers to and from the GPU. A CPU rasteriser copies them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/error.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/handle.hpp"

namespace penumbra {

struct PixelBuffer {
  BufferHandle handle;  // made on demand
  std::size_t bytes = 0;
  // Binds to `target`, with this size.
  void bind(unsigned target, std::size_t size, unsigned usage);
};

// Uploads: textures are filled from these buffers.
class UploadBuffers {
 public:
  // Maps the next buffer, which the caller must overwrite in full. Empty on failure.
  [[nodiscard]] std::span<std::uint8_t> map(std::size_t bytes);
  // Ends the writing and keeps the buffer bound as the source of texture uploads until unbind().
  // Returns false and unbinds it if the driver lost the contents.
  [[nodiscard]] bool unmap();
  static void unbind();

 private:
  // The CPU writes one buffer, the GPU reads one, and the driver may be one frame behind.
  std::array<PixelBuffer, 3> buffers_;
  std::size_t next_ = 0;
};

// Read-backs: an image is requested after it is drawn and read while the next one is drawn.
class ReadBackBuffers {
 public:
  static constexpr std::size_t kMaxPending = 2;  // pending images

  // Requests the current image, width * height * 4 bytes.
  void ask(const Framebuffer& image, std::size_t bytes);
  [[nodiscard]] std::size_t pending_reads() const { return pending_; }
  // Reads the oldest pending image; waits until it is drawn.
  [[nodiscard]] Result<void> take(std::span<std::uint8_t> rgba);
  // Drop the newest pending image, or all pending images.
  void drop_last();
  void drop_all() { pending_ = 0; }

 private:
  std::array<PixelBuffer, kMaxPending> buffers_;
  std::size_t first_ = 0, pending_ = 0;  // ring: oldest pending image, number of pending images
};

}  // namespace penumbra
