// The types of the fields of a glTF file's JSON.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

namespace penumbra::gltf {

// Checks each field that is read: tinygltf takes one of a wrong type for an absent one. Whole
// numbers that are written as 1.0 become integers; null becomes absent. Returns the place and the
// fault of the first that is wrong. A wrong field of materials and their textures, which change no
// shape, is erased instead and named in `erased`.
[[nodiscard]] std::optional<std::string> wrong_field(nlohmann::json& root,
                                                     std::vector<std::string>& erased);

}  // namespace penumbra::gltf
