// Power distance on a raster: D(x) = min over sites p of |x - p|^2 - r(p)^2, the squared distance
// to discs, negative inside one (docs/shadows.md#power-distance).
#pragma once

#include <cstddef>
#include <vector>

namespace penumbra {

// Keeps its memory from one raster to the next.
class PowerTransform {
 public:
  // Width and height of the raster [cells].
  void start(int width, int height);
  // A disc about the centre of a cell of the raster; radius >= 0 [cells].
  void add(int column, int row, float radius) { sites_.push_back({column, row, radius}); }
  // Computes D from the sites since start().
  void run();

  // The value of D beyond bound().
  static constexpr float kFar = 1e6F;

  // After run(): D of a row's cells [cells^2].
  [[nodiscard]] const float* row(int index) const {
    return values_.data() + static_cast<std::size_t>(index) * stride_;
  }
  // D is exact up to this value, which is above that of any cell beside the discs' outline.
  [[nodiscard]] float bound() const { return bound_; }

 private:
  struct Site {
    int column, row;
    float radius;
  };

  int width_ = 0, height_ = 0;
  std::size_t stride_ = 0;  // of values_: whole strips of cells
  float bound_ = 0.0F;
  std::vector<Site> sites_;
  std::vector<float> values_;
  std::vector<float> squares_;  // d^2 for d from -squares_reach_ on
  int squares_reach_ = -1;
  std::vector<float> strips_;  // two copies of a strip of columns
};

}  // namespace penumbra
