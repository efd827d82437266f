// Power distance to discs on a raster: D(x) = min over disc centres p of |x - p|^2 - r(p)^2,
// negative inside a disc (docs/shadows.md#power-distance).
#pragma once

#include <cstddef>
#include <vector>

namespace penumbra {

// Reuses its memory for the next raster.
class PowerTransform {
 public:
  // Begins a raster of this width and height [cells].
  void start(int width, int height);
  // Adds a disc at the centre of a cell; radius >= 0 [cells].
  void add(int column, int row, float radius) { sites_.push_back({column, row, radius}); }
  // Computes D for the discs added since start().
  void run();

  // Value of D for cells beyond bound().
  static constexpr float kFar = 1e6F;

  // Returns D for the cells of a row [cells^2]. Requires run().
  [[nodiscard]] const float* row(int index) const {
    return values_.data() + static_cast<std::size_t>(index) * stride_;
  }
  // D is exact up to this value, which exceeds D of every cell next to the discs' outline.
  [[nodiscard]] float bound() const { return bound_; }

 private:
  struct Site {
    int column, row;
    float radius;
  };

  int width_ = 0, height_ = 0;
  std::size_t stride_ = 0;  // row length of values_, a multiple of the strip width
  float bound_ = 0.0F;
  std::vector<Site> sites_;
  std::vector<float> values_;
  std::vector<float> squares_;  // d^2 for d >= -squares_reach_
  int squares_reach_ = -1;
  std::vector<float> strips_;  // two copies of a strip of columns
};

}  // namespace penumbra
