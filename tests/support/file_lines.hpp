// Reads a text file whose lines are all complete.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "core/text/text.hpp"

namespace penumbra::test {

// Returns the lines without line breaks. Fails the test if the last one has no line break.
inline std::vector<std::string> complete_lines(const std::filesystem::path& file) {
  const std::string text = read_text_file(file, 1 << 20).value();
  std::vector<std::string> lines;
  for (const auto line : split(text, '\n')) lines.emplace_back(line);
  EXPECT_EQ(lines.back(), "") << "the last line is complete";
  lines.pop_back();
  return lines;
}

}  // namespace penumbra::test
