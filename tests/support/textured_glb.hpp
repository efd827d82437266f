// A .glb with a square of 0.2 m that faces up, one material and its images.
#pragma once

#include <fmt/format.h>
#include <spng.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#include "core/image/image_file.hpp"

namespace penumbra::test {

inline RgbaImage image_of(int width, int height,
                          const std::function<std::array<int, 4>(int x, int y)>& at) {
  RgbaImage image{width, height, {}};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (const int value : at(x, y)) image.pixels.push_back(static_cast<std::uint8_t>(value));
    }
  }
  return image;
}
inline RgbaImage one_color(int r, int g, int b, int a = 255) {
  return image_of(4, 4, [=](int, int) { return std::array<int, 4>{r, g, b, a}; });
}
// Encodes a PNG with alpha.
inline std::string png_bytes(const RgbaImage& image) {
  spng_ctx* context = spng_ctx_new(SPNG_CTX_ENCODER);
  spng_set_option(context, SPNG_ENCODE_TO_BUFFER, 1);
  spng_ihdr header{};
  header.width = static_cast<std::uint32_t>(image.width);
  header.height = static_cast<std::uint32_t>(image.height);
  header.bit_depth = 8;
  header.color_type = SPNG_COLOR_TYPE_TRUECOLOR_ALPHA;
  spng_set_ihdr(context, &header);
  std::string bytes;
  if (spng_encode_image(context, image.pixels.data(), image.pixels.size(), SPNG_FMT_PNG,
                        SPNG_ENCODE_FINALIZE) == 0) {
    std::size_t size = 0;
    int error = 0;
    void* coded = spng_get_png_buffer(context, &size, &error);
    if (coded != nullptr) bytes.assign(static_cast<const char*>(coded), size);
    std::free(coded);
  }
  spng_ctx_free(context);
  return bytes;
}

struct TexturedSquare {
  std::string material;             // JSON fields of the material
  std::vector<std::string> images;  // encoded; texture i shows image i
  std::string samplers = "{}";
  // Texture coordinates of the corners, anticlockwise from the near left corner. The images
  // appear upright.
  std::vector<std::array<float, 2>> texcoords = {{0, 1}, {1, 1}, {1, 0}, {0, 0}};
  std::vector<std::array<float, 2>> texcoords_1;
  std::vector<std::array<float, 3>> normals = std::vector<std::array<float, 3>>(4, {0, 1, 0});
  std::vector<std::array<float, 4>> tangents;
  std::string node;  // additional JSON fields of the node
};

inline std::string glb_of(const TexturedSquare& square) {
  std::string binary, views, accessors, attributes;
  int view_count = 0;
  const auto add_view = [&](const void* data, std::size_t size) {
    binary.resize((binary.size() + 3) / 4 * 4, '\0');
    views += fmt::format("{}{{\"buffer\":0,\"byteOffset\":{},\"byteLength\":{}}}",
                         views.empty() ? "" : ",", binary.size(), size);
    binary.append(static_cast<const char*>(data), size);
    return view_count++;
  };
  int accessor_count = 0;
  const auto add_accessor = [&](const auto& values, const char* type, int component) {
    const int view = add_view(values.data(), values.size() * sizeof(values[0]));
    accessors += fmt::format(
        "{}{{\"bufferView\":{},\"componentType\":{},"
        "\"count\":{},\"type\":\"{}\"}}",
        accessors.empty() ? "" : ",", view, component, values.size(), type);
    return accessor_count++;
  };
  const auto add_attribute = [&](const char* name, const auto& values, const char* type) {
    if (values.empty()) return;
    attributes += fmt::format("{}\"{}\":{}", attributes.empty() ? "" : ",", name,
                              add_accessor(values, type, 5126));
  };
  const std::vector<std::array<float, 3>> positions = {
      {-0.1F, 0, 0.1F}, {0.1F, 0, 0.1F}, {0.1F, 0, -0.1F}, {-0.1F, 0, -0.1F}};
  add_attribute("POSITION", positions, "VEC3");
  add_attribute("NORMAL", square.normals, "VEC3");
  add_attribute("TANGENT", square.tangents, "VEC4");
  add_attribute("TEXCOORD_0", square.texcoords, "VEC2");
  add_attribute("TEXCOORD_1", square.texcoords_1, "VEC2");
  const std::vector<std::uint32_t> order = {0, 1, 2, 0, 2, 3};
  const int indices = add_accessor(order, "SCALAR", 5125);
  std::string images, textures;
  for (std::size_t i = 0; i < square.images.size(); ++i) {
    const int view = add_view(square.images[i].data(), square.images[i].size());
    images +=
        fmt::format("{}{{\"bufferView\":{},\"mimeType\":\"image/png\"}}", i == 0 ? "" : ",", view);
    textures += fmt::format("{}{{\"source\":{},\"sampler\":0}}", i == 0 ? "" : ",", i);
  }
  std::string texture_fields;
  if (!square.images.empty()) {
    texture_fields = fmt::format("\"images\":[{}],\"textures\":[{}],\"samplers\":[{}],", images,
                                 textures, square.samplers);
  }
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  std::string json = fmt::format(
      "{{\"asset\":{{\"version\":\"2.0\"}},\"scene\":0,\"scenes\":[{{\"nodes\":"
      "[0]}}],"
      "\"nodes\":[{{\"mesh\":0{}}}],\"meshes\":[{{\"primitives\":[{{"
      "\"attributes\":{{{}}},"
      "\"indices\":{},\"material\":0}}]}}],\"materials\":[{{{}}}],{}"
      "\"accessors\":[{}],"
      "\"bufferViews\":[{}],\"buffers\":[{{\"byteLength\":{}}}]}}",
      square.node.empty() ? "" : "," + square.node, attributes, indices, square.material,
      texture_fields, accessors, views, binary.size());
  json.resize((json.size() + 3) / 4 * 4, ' ');
  std::string glb;
  const auto word = [&glb](std::size_t value) {
    const auto word32 = static_cast<std::uint32_t>(value);
    char bytes[4];
    std::memcpy(bytes, &word32, 4);
    glb.append(bytes, 4);
  };
  word(0x46546C67);
  word(2);
  word(12 + 8 + json.size() + 8 + binary.size());
  word(json.size());
  word(0x4E4F534A);
  glb += json;
  word(binary.size());
  word(0x004E4942);
  glb += binary;
  return glb;
}

}  // namespace penumbra::test
