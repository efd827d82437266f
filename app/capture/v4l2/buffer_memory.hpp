// A driver's buffer, mapped read-only. If it is exported as DMA-BUF (memory that Linux shares among
// devices), a GPU can read it in place, and it stays valid after the camera is disconnected.
#pragma once

#include <cstdint>
#include <span>
#include <tl/expected.hpp>

#include "app/capture/v4l2/v4l2_device.hpp"

namespace penumbra {

class BufferMemory {
 public:
  // Maps the first `length` bytes of a DMA-BUF. Takes ownership of the descriptor, even on failure.
  // Errors are errnos.
  [[nodiscard]] static tl::expected<BufferMemory, int> map(int descriptor, std::size_t length);
  // Maps buffer `index` of a device (V4L2_MEMORY_MMAP), as DMA-BUF if `share` is set and the driver
  // can export it. With DMA-BUF, a reconnected camera gets its old device number even if frames are
  // still in use. Errors are errnos.
  [[nodiscard]] static tl::expected<BufferMemory, int> map(const V4l2Device& device, unsigned index,
                                                           bool share);
  BufferMemory(BufferMemory&& other) noexcept;
  BufferMemory& operator=(BufferMemory&& other) noexcept;
  BufferMemory(const BufferMemory&) = delete;
  BufferMemory& operator=(const BufferMemory&) = delete;
  ~BufferMemory();

  [[nodiscard]] std::span<const std::uint8_t> bytes() const { return bytes_; }
  [[nodiscard]] bool is_shared() const { return descriptor_ >= 0; }
  // The DMA-BUF's descriptor, owned by this object; -1 if not shared.
  [[nodiscard]] int descriptor() const { return descriptor_; }
  // Number that is unique in this process and never reused.
  [[nodiscard]] std::uint64_t number() const { return number_; }
  // Call these before and after the CPU reads shared memory; they keep the CPU's caches coherent.
  void begin_reading() const;
  void end_reading() const;

 private:
  BufferMemory() = default;

  std::span<const std::uint8_t> bytes_;
  int descriptor_ = -1;
  std::uint64_t number_ = 0;
};

}  // namespace penumbra
