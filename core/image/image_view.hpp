// The size of an image, and a view of an 8-bit plane: rows of `width` bytes, `stride` bytes apart.
#pragma once

#include <cstddef>
#include <cstdint>

namespace penumbra {

struct ImageSize {
  int width = 0;   // [px]
  int height = 0;  // [px]
  bool operator==(const ImageSize&) const = default;
};

struct ImageView {
  const std::uint8_t* data = nullptr;
  int width = 0;              // [px]
  int height = 0;             // [px]
  std::ptrdiff_t stride = 0;  // [bytes] between rows, >= width

  [[nodiscard]] bool empty() const { return data == nullptr || width <= 0 || height <= 0; }
  [[nodiscard]] const std::uint8_t* row(int y) const { return data + y * stride; }
};

}  // namespace penumbra
