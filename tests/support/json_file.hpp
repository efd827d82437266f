// Reads a whole JSON file.
#pragma once

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

namespace penumbra::test {

// Returns a discarded value if the file is missing or can't be parsed: each access to it throws or
// is null.
inline nlohmann::json read_json(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return nlohmann::json::parse(stream, nullptr, false);
}

}  // namespace penumbra::test
