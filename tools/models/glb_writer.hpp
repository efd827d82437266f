// Model -> binary glTF 2.0.
#pragma once

#include <cstdint>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra::models {

// Returns the bytes of a .glb: one node and mesh for each name, with one primitive for each
// material. The model's z is up; glTF's y is, so (x, y, z) is written as (x, z, -y). The same model
// always gives the same bytes.
[[nodiscard]] Result<std::vector<std::uint8_t>> encode_glb(const Model& model);

}  // namespace penumbra::models
