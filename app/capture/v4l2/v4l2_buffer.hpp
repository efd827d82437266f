// One buffer of a V4L2 driver, mapped to be read: as DMA-BUF where the driver exports it. Then a
// camera that was unplugged comes back under its own number though frames are still held.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <tl/expected.hpp>

#include "app/capture/v4l2/dma_buf_memory.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"

namespace penumbra {

class V4l2Buffer {
 public:
  // Buffer `index` of those that the device was asked for (V4L2_MEMORY_MMAP). `share`: as DMA-BUF,
  // where that is possible. Fails with an errno.
  [[nodiscard]] static tl::expected<V4l2Buffer, int> map(const V4l2Device& device, unsigned index,
                                                         bool share);
  V4l2Buffer(V4l2Buffer&& other) noexcept;
  V4l2Buffer& operator=(V4l2Buffer&& other) noexcept;
  V4l2Buffer(const V4l2Buffer&) = delete;
  V4l2Buffer& operator=(const V4l2Buffer&) = delete;
  ~V4l2Buffer();

  [[nodiscard]] std::span<const std::uint8_t> bytes() const {
    return shared_ ? shared_->bytes() : own_;
  }
  // Nothing where it is not shared.
  [[nodiscard]] const std::optional<DmaBufMemory>& shared() const { return shared_; }
  // Between these the processor reads it. A plain mapping's driver makes the caches agree when it
  // hands the buffer out.
  void begin_reading() const;
  void end_reading() const;

 private:
  V4l2Buffer() = default;

  std::optional<DmaBufMemory> shared_;
  std::span<const std::uint8_t> own_;  // mapped from the device, where it is not shared
};

}  // namespace penumbra
