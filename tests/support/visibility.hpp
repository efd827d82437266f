// visibility.csv of a rendered recording: corners in the image and occluded fraction of each tag in
// each frame.
#pragma once

#include <algorithm>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include "core/text/text.hpp"

namespace penumbra::test {

// Returns for each frame the maximum over the tags of the number of corners in the image (0 to 4).
// Empty if the file can't be read.
inline std::vector<int> max_corners_in_view(const std::filesystem::path& recording,
                                            std::size_t frames) {
  const auto text = read_text_file(recording / "visibility.csv", 1 << 20);
  if (!text) return {};
  std::vector<int> corners(frames, 0);
  std::istringstream lines(*text);
  std::string line;
  std::getline(lines, line);  // skips the header line
  while (std::getline(lines, line)) {
    std::size_t frame = 0;
    int id = 0;
    int count = 0;
    char comma = 0;
    std::istringstream fields(line);
    fields >> frame >> comma >> id >> comma >> count;
    if (!fields || frame >= frames) return {};
    corners[frame] = std::max(corners[frame], count);
  }
  return corners;
}

}  // namespace penumbra::test
