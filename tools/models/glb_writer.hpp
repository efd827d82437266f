// Model -> binary glTF 2.0.
#pragma once

#include <cstdint>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra::models {

// Returns the bytes of a .glb with one node and mesh per name and one primitive per material. The
// model's z axis is up and glTF's y axis is, so (x, y, z) is written as (x, z, -y). The same model
// always gives the same bytes.
[[nodiscard]] Result<std::vector<std::uint8_t>> encode_glb(const Model& model);

}  // namespace penumbra::models
