// Memory that Linux shares among devices (DMA-BUF), mapped to be read: a GPU can take a picture
// from where the camera put it, and the memory belongs to whoever holds it, also when the camera is
// gone.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <tl/expected.hpp>

namespace penumbra {

class DmaBufMemory {
 public:
  // Its first `length` bytes. The descriptor is taken over, where it can't be mapped too. Fails
  // with an errno.
  [[nodiscard]] static tl::expected<DmaBufMemory, int> map(int descriptor, std::size_t length);
  DmaBufMemory(DmaBufMemory&& other) noexcept;
  DmaBufMemory& operator=(DmaBufMemory&& other) noexcept;
  DmaBufMemory(const DmaBufMemory&) = delete;
  DmaBufMemory& operator=(const DmaBufMemory&) = delete;
  ~DmaBufMemory();

  [[nodiscard]] std::span<const std::uint8_t> bytes() const { return bytes_; }
  // Owned by this.
  [[nodiscard]] int descriptor() const { return descriptor_; }
  // Which memory it is: a number that no other of this process has or had.
  [[nodiscard]] std::uint64_t number() const { return number_; }
  // Between these the processor reads it: caches are made to agree where they would not by
  // themselves.
  void begin_reading() const;
  void end_reading() const;

 private:
  explicit DmaBufMemory(int descriptor) : descriptor_(descriptor) {}

  std::span<const std::uint8_t> bytes_;
  int descriptor_ = -1;
  std::uint64_t number_ = 0;
};

}  // namespace penumbra
