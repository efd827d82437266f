// A JSON file, read whole.
#pragma once

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

namespace penumbra::test {

// What can't be parsed, or isn't there, gives a discarded value: every access to it throws or is
// null.
inline nlohmann::json read_json(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return nlohmann::json::parse(stream, nullptr, false);
}

}  // namespace penumbra::test
