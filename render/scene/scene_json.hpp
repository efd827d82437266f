// Reads a scene file as JSON and validates it against the published schema.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// Returns the published JSON Schema of scenes, embedded at build time.
[[nodiscard]] std::string_view scene_schema();

// Fails if the file can't be read, is not JSON, has a duplicate key or violates the schema; the
// message contains the JSON pointer and the remedy. `content`, if not null, receives the text.
[[nodiscard]] Result<nlohmann::json> read_scene_json(const std::filesystem::path& file,
                                                     std::string* content = nullptr);
// Checks a scene against the schema, with the same messages. `name`: the file, for messages.
[[nodiscard]] Result<void> check_scene_json(const std::string& name, const nlohmann::json& root);

// Returns "did you mean X?" if a known word is similar, else a list of the known words.
[[nodiscard]] std::string suggestion(std::string_view word, const std::vector<std::string>& known);

}  // namespace penumbra
