// Differences of an image from a reference image with a higher resolution, at edges and elsewhere.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "support/studio.hpp"

namespace penumbra::test {

// Returns a camera without distortion that has the same view for every `scale`, and `scale` times
// `width` x `height` pixels. Its first `scale` x `scale` pixels cover pixel (0, 0) of scale 1.
inline CameraParameters enlarged_view(int width, int height, int scale) {
  CameraParameters p;
  p.width = scale * width;
  p.height = scale * height;
  p.fx = p.fy = scale * 280.0;
  p.cx = scale * (0.5 * width + 1.7 + 0.5) - 0.5;
  p.cy = scale * (0.5 * height - 2.1 + 0.5) - 0.5;
  return p;
}

struct EdgeError {
  double rms = 0.0;           // difference at edges [grey levels]
  int edges = 0;              // number of pixels at edges
  int largest_elsewhere = 0;  // largest difference away from edges [grey levels]
};
// Compares each pixel of the image with the mean of its `times` x `times` pixels in the fine image.
inline EdgeError edge_error(const RenderedImage& image, const RenderedImage& fine, int times) {
  EdgeError error;
  double sum = 0.0;
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      int low = 255, high = 0, total = 0;
      for (int i = 0; i < times * times; ++i) {
        const int value = fine.red(times * x + i % times, times * y + i / times);
        low = std::min(low, value);
        high = std::max(high, value);
        total += value;
      }
      const double difference = image.red(x, y) - static_cast<double>(total) / (times * times);
      if (low != high) {
        sum += difference * difference;
        ++error.edges;
      }
    }
  }
  // Compares pixels that are more than two pixels away from every edge of the fine image.
  for (int y = 2; y + 2 < image.height; ++y) {
    for (int x = 2; x + 2 < image.width; ++x) {
      const int value = fine.red(times * x, times * y);
      bool flat = true;
      for (int j = -2 * times; j < 3 * times && flat; ++j) {
        for (int i = -2 * times; i < 3 * times && flat; ++i)
          flat = fine.red(times * x + i, times * y + j) == value;
      }
      if (flat) {
        error.largest_elsewhere =
            std::max(error.largest_elsewhere, std::abs(image.red(x, y) - value));
      }
    }
  }
  error.rms = std::sqrt(sum / error.edges);
  return error;
}

}  // namespace penumbra::test
