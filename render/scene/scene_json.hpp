// The text of a scene file -> JSON that keeps to the published schema. What a schema can't say
// (names that must exist, keys that go together) scene_file.cpp checks.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// Fails where the file can't be read, is no JSON, gives a key twice or breaks the schema; the
// message names the place in the file and what to do.
[[nodiscard]] Result<nlohmann::json> read_scene_json(const std::filesystem::path& file);

// For messages: a long text's beginning, and "did you mean X?" where a word of the list is near,
// else the list.
[[nodiscard]] std::string shortened(const std::string& text);
[[nodiscard]] std::string suggestion(std::string_view word, const std::vector<std::string>& known);

}  // namespace penumbra
