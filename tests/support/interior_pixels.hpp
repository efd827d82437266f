// Compares an image with the expected value of each pixel, with tolerance where edges may fall on
// either side of a pixel.
#pragma once

#include <cstddef>
#include <vector>

namespace penumbra::test {

struct InteriorPixels {
  int pixels = 0, wrong = 0;
};

// Counts the pixels of a square image whose 3 x 3 neighbourhood has one expected value, and how
// many of these pixels are wrong. `expected` holds a value per pixel; a pixel with a negative value
// is not compared, and neither are its neighbours.
inline InteriorPixels count_interior_pixels(int side, const std::vector<int>& expected,
                                            const std::vector<bool>& wrong) {
  InteriorPixels found;
  for (int y = 1; y + 1 < side; ++y) {
    for (int x = 1; x + 1 < side; ++x) {
      const auto at = [&](int dx, int dy) {
        return static_cast<std::size_t>(side * (y + dy) + x + dx);
      };
      const int value = expected[at(0, 0)];
      bool alike = value >= 0;
      for (int i = 0; i < 9; ++i) alike = alike && expected[at(i % 3 - 1, i / 3 - 1)] == value;
      found.pixels += alike ? 1 : 0;
      found.wrong += alike && wrong[at(0, 0)] ? 1 : 0;
    }
  }
  return found;
}

}  // namespace penumbra::test
