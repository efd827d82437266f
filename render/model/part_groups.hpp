// Groups of a model's parts that count as one part. Kernels are made for each connected part and
// each part shrinks about its own: a wall of loose bricks would open at its joints as the umbra
// shrinks.
//
// A group is "all", or a name as the model's file has it: of a glTF node or mesh, of an OBJ object
// or group; * and ? stand for what varies ("brick*"). A node brings everything below it along.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra {

inline constexpr std::string_view kGroupOfAll = "all";

// Returns for each of Model::nodes whether it belongs to the group.
[[nodiscard]] std::vector<bool> nodes_of_group(const Model& model, const std::string& group);

// Fails where a group has no node; the message names the group and what there is.
[[nodiscard]] Result<void> check_groups(const Model& model, std::span<const std::string> groups);

}  // namespace penumbra
