// Decodes buffer views compressed with EXT_meshopt_compression or KHR_meshopt_compression.
#pragma once

#include <tiny_gltf.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/error.hpp"

namespace penumbra::gltf {

// The extension's fields of a buffer view.
struct MeshoptView {
  std::string json_path;
  std::size_t buffer = 0;
  std::size_t byte_offset = 0;
  std::size_t byte_length = 0;  // compressed size
  std::size_t byte_stride = 0;
  std::size_t count = 0;  // elements; indices in mode TRIANGLES
  std::string mode;
  std::string filter;

  [[nodiscard]] std::size_t decoded_bytes() const { return count * byte_stride; }
};

// Returns nullopt for an uncompressed buffer view. Checks that mode, filter, sizes and the buffer
// view agree.
[[nodiscard]] Result<std::optional<MeshoptView>> meshopt_view(const tinygltf::BufferView& view,
                                                              const std::string& json_path);

// `coded`: the view's byte_length bytes of its buffer. The caller must limit decoded_bytes().
[[nodiscard]] Result<std::vector<std::uint8_t>> decode_meshopt(const MeshoptView& view,
                                                               std::span<const std::uint8_t> coded);

}  // namespace penumbra::gltf
