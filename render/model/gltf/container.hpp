// The container of a glTF file: the chunks of a .glb, and limits that readers of its JSON rely on.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra::gltf {

struct Container {
  std::string_view json;
  std::optional<std::span<const std::uint8_t>> binary;  // the data of a .glb's first buffer
};

// Walks over the chunks of a .glb, each of which lies in the file.
[[nodiscard]] Result<Container> open_glb(const std::string& name,
                                         std::span<const std::uint8_t> bytes);

// Returns the nesting depth of the brackets outside strings: readers of JSON recurse.
[[nodiscard]] int nesting_depth(std::string_view json);

}  // namespace penumbra::gltf
