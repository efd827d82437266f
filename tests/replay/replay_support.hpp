// Helpers for the replay tests, which run the built program on recordings and read its outputs.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>
#include <vector>

#include "support/json_file.hpp"
#include "support/paths.hpp"
#include "support/run_program.hpp"

namespace penumbra::test {

inline ProgramResult penumbra(const std::vector<std::string>& arguments,
                              const std::vector<std::string>& environment = {}) {
  return run_program(program(), arguments, environment);
}

// Runs the program in a real window, on a virtual display.
inline ProgramResult in_window(std::vector<std::string> arguments,
                               const std::filesystem::path& working_folder) {
  arguments.insert(arguments.begin(), program().string());
  return run_program(source_dir() / "tests" / "support" / "with-display", arguments, {},
                     working_folder);
}

inline std::string bundled(const char* name) {
  return (recordings_dir() / name).string();
}

// Writes a scene without objects and shadows and returns its path. For tests of tracking, because
// drawing takes longer.
inline std::string empty_scene_in(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "empty.json";
  std::ofstream(file) << R"({"objects": [], "shadows": []})";
  return file.string();
}

// Returns true if Xvfb is installed, which tests/support/with-display needs.
inline bool has_xvfb() {
  return std::system("command -v Xvfb >/dev/null 2>&1") == 0;
}

inline std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

// Returns size and FNV-1a hash of a file; empty if the file is missing. A failed comparison prints
// them instead of all bytes.
inline std::string fingerprint_of(const std::filesystem::path& file) {
  const std::string bytes = bytes_of(file);
  if (bytes.empty()) return {};
  std::uint64_t hash = 14695981039346656037U;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211U;
  return std::to_string(bytes.size()) + " bytes, " + std::to_string(hash);
}

// Maps the name of every file in a folder to its fingerprint.
inline std::map<std::string, std::string> contents_of(const std::filesystem::path& folder) {
  std::map<std::string, std::string> contents;
  std::error_code none;
  for (const auto& entry : std::filesystem::directory_iterator(folder, none)) {
    contents[entry.path().filename().string()] =
        entry.is_directory() ? "a folder" : fingerprint_of(entry.path());
  }
  return contents;
}

inline std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::size_t start = 0;
  while (start < text.size()) {
    const std::size_t end = std::min(text.find('\n', start), text.size());
    lines.push_back(text.substr(start, end - start));
    start = end + 1;
  }
  return lines;
}

// Returns the last line; empty for an empty text.
inline std::string last_line_of(const std::string& text) {
  const std::vector<std::string> lines = lines_of(text);
  return lines.empty() ? "" : lines.back();
}

// Expects exit code 1 and exactly one line on standard error, which contains each of `parts`.
inline void expect_failure(const ProgramResult& result, const std::vector<std::string>& parts) {
  EXPECT_EQ(result.exit_code, 1) << result.err;
  const std::vector<std::string> lines = lines_of(result.err);
  ASSERT_EQ(lines.size(), 1U) << result.err;
  EXPECT_TRUE(lines[0].starts_with("penumbra: error: ")) << lines[0];
  for (const std::string& part : parts) {
    EXPECT_NE(lines[0].find(part), std::string::npos) << "'" << part << "' is not in: " << lines[0];
  }
}

}  // namespace penumbra::test
