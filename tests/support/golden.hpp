// Compares images with golden images on disk.
//
// An image passes if it equals the golden image exactly, since the same build on the same
// rasteriser draws the same bits. It also passes if at most 0.01 % of its pixels differ by more
// than 2 grey levels (edges that another rasteriser draws differently). On failure the image, the
// golden image and their difference are written to the build folder's golden-output/.
//
// With another implementation of OpenGL (scripts/test-softpipe) the limit is 0.2 % of the pixels.
//
// scripts/renew-goldens (PENUMBRA_RENEW_GOLDENS=1) writes the golden images instead. Check them by
// eye before you commit them.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "core/image/image_file.hpp"
#include "support/paths.hpp"

namespace penumbra::test {

struct ImageDifference {
  bool same_size = false;
  bool exact = false;
  std::size_t pixels = 0;
  std::size_t over_tolerance = 0;  // pixels that differ by more than 2 grey levels in any channel
  int largest = 0;                 // largest difference [grey levels]

  static constexpr int kToleranceGreyLevels = 2;
  // Returns true if at most 0.01 % of the pixels are over the tolerance.
  [[nodiscard]] bool acceptable() const { return same_size && over_tolerance * 10'000 <= pixels; }
  // Like acceptable(), with the limit for another implementation of OpenGL: 0.2 % of the pixels.
  [[nodiscard]] bool acceptable_with_other_opengl() const {
    return same_size && over_tolerance * 500 <= pixels;
  }
};

// Compares colour only, since the PNG files of golden images have no alpha.
inline ImageDifference compare(const RgbaImage& actual, const RgbaImage& golden) {
  ImageDifference d;
  d.same_size = actual.width == golden.width && actual.height == golden.height &&
                actual.pixels.size() == golden.pixels.size();
  if (!d.same_size) return d;
  d.pixels = actual.pixels.size() / 4;
  for (std::size_t i = 0; i < actual.pixels.size(); i += 4) {
    int difference = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      difference = std::max(difference, std::abs(static_cast<int>(actual.pixels[i + c]) -
                                                 static_cast<int>(golden.pixels[i + c])));
    }
    d.largest = std::max(d.largest, difference);
    if (difference > ImageDifference::kToleranceGreyLevels) ++d.over_tolerance;
  }
  d.exact = d.largest == 0;
  return d;
}

inline std::filesystem::path golden_dir() {
  return source_dir() / "tests" / "golden";
}
inline std::filesystem::path golden_output_dir() {
  return program().parent_path() / "golden-output";
}

inline void write_failure(const std::string& name, const RgbaImage& actual,
                          const RgbaImage& golden) {
  std::filesystem::create_directories(golden_output_dir());
  const auto write = [&](const char* kind, const RgbaImage& image) {
    if (image.pixels.empty()) return;
    const auto file = golden_output_dir() / (name + "." + kind + ".png");
    const auto saved = save_png(file, image.width, image.height, image.pixels);
    std::printf("%s\n", saved ? file.c_str() : saved.error().message.c_str());
  };
  write("actual", actual);
  write("golden", golden);
  if (actual.width != golden.width || actual.height != golden.height) return;
  RgbaImage difference = actual;
  for (std::size_t i = 0; i < difference.pixels.size(); ++i) {
    const int d = std::abs(static_cast<int>(actual.pixels[i]) - static_cast<int>(golden.pixels[i]));
    difference.pixels[i] = static_cast<std::uint8_t>(std::min(255, d * 16));  // amplified
  }
  write("difference", difference);
}

// `name` without folder and extension: SCENE__RECORDING__TECHNIQUE__FRAME.
inline testing::AssertionResult matches_golden(const std::string& name, const RgbaImage& actual) {
  const auto file = golden_dir() / (name + ".png");
  const char* renew = std::getenv("PENUMBRA_RENEW_GOLDENS");
  if (renew != nullptr && std::string(renew) == "1") {
    const auto saved = save_png(file, actual.width, actual.height, actual.pixels);
    if (!saved) return testing::AssertionFailure() << saved.error().message;
    // A run that writes the golden images fails, because it compared nothing.
    return testing::AssertionFailure()
           << file << " renewed; run again without PENUMBRA_RENEW_GOLDENS";
  }
  const auto golden = load_rgba(file);
  if (!golden) {
    write_failure(name, actual, RgbaImage());
    return testing::AssertionFailure() << golden.error().message;
  }
  const ImageDifference d = compare(actual, *golden);
  if (d.exact && d.same_size) return testing::AssertionSuccess();
  const char* other_opengl = std::getenv("PENUMBRA_OTHER_OPENGL");
  if (d.acceptable() || (other_opengl != nullptr && d.acceptable_with_other_opengl())) {
    std::printf("%s: not bit-identical: %zu px over tolerance\n", name.c_str(),
                static_cast<std::size_t>(d.over_tolerance));
    return testing::AssertionSuccess();
  }
  write_failure(name, actual, *golden);
  return testing::AssertionFailure()
         << name << ": " << d.over_tolerance << " of " << d.pixels << " px differ by more than "
         << ImageDifference::kToleranceGreyLevels << " grey levels, the largest by " << d.largest
         << "; see " << golden_output_dir();
}

}  // namespace penumbra::test
