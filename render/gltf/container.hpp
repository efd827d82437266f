// The container of a glTF file: the JSON text in a .glb, and limits that readers of it rely on.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Returns the JSON text of a .glb, after a walk over its chunks: tinygltf 2.7.0 lets a binary chunk
// reach 8 bytes past the end of the file.
[[nodiscard]] Result<std::string_view> json_chunk(const std::string& name,
                                                  std::span<const std::uint8_t> bytes);

// Returns how deep brackets nest, strings left out: tinygltf walks over `extras` by recursion.
[[nodiscard]] int nesting_depth(std::string_view json);

}  // namespace penumbra
