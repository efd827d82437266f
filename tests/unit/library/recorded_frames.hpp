// Frames of a bundled recording for tests of the library, read without the modules.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <penumbra/error.hpp>
#include <penumbra/tracking.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "support/paths.hpp"

namespace penumbra::test {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct RecordedImage {
  std::int64_t timestamp_ns = 0;
  types::Image image;
};

// Returns the first `count` frames of recordings/NAME.
inline std::vector<RecordedImage> recorded_images(const std::string& name, std::size_t count) {
  const std::filesystem::path folder = recordings_dir() / name;
  std::ifstream lines(folder / "timestamps.csv");
  std::string line;
  std::getline(lines, line);  // the header
  std::vector<RecordedImage> images;
  while (images.size() < count && std::getline(lines, line)) {
    std::istringstream row(line);
    std::string number;
    std::string time;
    std::string file;
    std::getline(row, number, ',');
    std::getline(row, time, ',');
    std::getline(row, file, ',');
    images.push_back({std::llround(1e9 * std::strtod(time.c_str(), nullptr)),
                      types::Image::load(folder / file)});
  }
  return images;
}

inline tracking::CameraModel camera_of(const std::string& recording) {
  return tracking::CameraModel::load(recordings_dir() / recording / "camera.yaml");
}
inline tracking::TagMap tags_of(const std::string& recording) {
  return tracking::TagMap::load(recordings_dir() / recording / "tags.yaml");
}

// Returns the message of the exception, or "" if the function throws none.
template <class Function>
std::string message_of(Function&& function) {
  try {
    function();
  } catch (const Exception& error) {
    return error.what();
  }
  return {};
}

}  // namespace penumbra::test
