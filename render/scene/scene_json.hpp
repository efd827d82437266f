// Reads the text of a scene file as JSON that keeps to the published schema.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// Returns the published JSON Schema of scenes, as it was when the program was built.
[[nodiscard]] std::string_view scene_schema();

// Fails if the file can't be read, is not JSON, has a key twice or breaks the schema; the message
// names the place in the file and the remedy.
[[nodiscard]] Result<nlohmann::json> read_scene_json(const std::filesystem::path& file);

// Returns the beginning of a long text, for messages.
[[nodiscard]] std::string shortened(const std::string& text);
// Returns "did you mean X?" if a known word is near, else a list of the known words.
[[nodiscard]] std::string suggestion(std::string_view word, const std::vector<std::string>& known);

}  // namespace penumbra
