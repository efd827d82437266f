#include "render/model/gltf/compression/webp.hpp"

#include <webp/decode.h>

#include <cstring>

#include "core/propagate.hpp"

namespace penumbra::gltf {

bool is_webp(std::span<const std::uint8_t> bytes) {
  return bytes.size() >= 12 && std::memcmp(bytes.data(), "RIFF", 4) == 0 &&
         std::memcmp(bytes.data() + 8, "WEBP", 4) == 0;
}

Result<RgbaImage> decode_webp(std::span<const std::uint8_t> bytes, const std::string& name) {
  WebPBitstreamFeatures features{};
  if (WebPGetFeatures(bytes.data(), bytes.size(), &features) != VP8_STATUS_OK) {
    return fail("{}: is a damaged WebP image; export the model again", name);
  }
  if (features.has_animation != 0) {
    return fail("{}: is a WebP animation; give a still image", name);
  }
  PENUMBRA_TRY_VOID(check_image_size(static_cast<std::uint64_t>(features.width),
                                     static_cast<std::uint64_t>(features.height), name));
  RgbaImage image{features.width, features.height, {}};
  const std::size_t row = 4 * static_cast<std::size_t>(image.width);
  image.pixels.resize(row * static_cast<std::size_t>(image.height));
  if (WebPDecodeRGBAInto(bytes.data(), bytes.size(), image.pixels.data(), image.pixels.size(),
                         static_cast<int>(row)) == nullptr) {
    return fail("{}: is a damaged or incomplete WebP image; export the model again", name);
  }
  return image;
}

}  // namespace penumbra::gltf
