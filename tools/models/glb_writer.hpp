// Model -> binary glTF 2.0.
#pragma once

#include <cstdint>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra::models {

// The bytes of a .glb: one node and mesh for each name, one primitive for each material of it. The
// model's z is up; the file's y is, as glTF asks: (x, y, z) is written as (x, z, -y). The same
// model gives the same bytes.
[[nodiscard]] Result<std::vector<std::uint8_t>> encode_glb(const Model& model);

}  // namespace penumbra::models
