// Groups of a model's connected components ("parts") that count as one part. Each part shrinks
// towards its own kernels, so without a group the umbra of a wall of loose bricks has gaps at the
// joints.
//
// A group is "all", or the name of a glTF node or mesh, or of an OBJ object or group. "*" and "?"
// are wildcards ("brick*"). A node includes its descendants.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra {

inline constexpr std::string_view kGroupOfAll = "all";

// Returns, for each of Model::nodes, whether it belongs to the group.
[[nodiscard]] std::vector<bool> nodes_of_group(const Model& model, const std::string& group);

// Fails if a group matches no node; the message lists the group and the available names.
[[nodiscard]] Result<void> check_groups(const Model& model, std::span<const std::string> groups);

}  // namespace penumbra
