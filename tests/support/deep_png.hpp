// PNG files with 16 bits per sample, as machine-vision cameras write them.
#pragma once

#include <gtest/gtest.h>
#include <spng.h>

#include <cstdint>
#include <cstdlib>
#include <optional>
#include <vector>

namespace penumbra::test {

struct DeepPng {
  int color_type = SPNG_COLOR_TYPE_GRAYSCALE;
  int channels = 1;
  bool alpha = false;
  bool interlaced = false;
  std::optional<int> significant_bits = std::nullopt;  // content of the chunk sBIT
};

inline std::vector<std::uint8_t> deep_png(const std::vector<std::uint16_t>& values, int width,
                                          int height, const DeepPng& layout = {}) {
  spng_ctx* png = spng_ctx_new(SPNG_CTX_ENCODER);
  spng_ihdr header{};
  header.width = static_cast<std::uint32_t>(width);
  header.height = static_cast<std::uint32_t>(height);
  header.bit_depth = 16;
  header.color_type = static_cast<std::uint8_t>(layout.color_type);
  header.interlace_method = layout.interlaced ? 1 : 0;
  EXPECT_EQ(spng_set_option(png, SPNG_ENCODE_TO_BUFFER, 1), 0);
  EXPECT_EQ(spng_set_ihdr(png, &header), 0);
  if (layout.significant_bits) {
    spng_sbit bits{};
    const auto count = static_cast<std::uint8_t>(*layout.significant_bits);
    bits.grayscale_bits = bits.red_bits = bits.green_bits = bits.blue_bits = count;
    bits.alpha_bits = 16;
    EXPECT_EQ(spng_set_sbit(png, &bits), 0);
  }
  EXPECT_EQ(spng_encode_image(png, values.data(), values.size() * sizeof(std::uint16_t),
                              SPNG_FMT_PNG, SPNG_ENCODE_FINALIZE),
            0);
  std::size_t size = 0;
  int status = 0;
  void* data = spng_get_png_buffer(png, &size, &status);
  std::vector<std::uint8_t> bytes(static_cast<std::uint8_t*>(data),
                                  static_cast<std::uint8_t*>(data) + size);
  std::free(data);
  spng_ctx_free(png);
  return bytes;
}

}  // namespace penumbra::test
