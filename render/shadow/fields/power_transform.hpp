// Power distance on a raster: D(x) = min over sites p of |x - p|^2 - r(p)^2, the squared distance
// to discs (negative inside of one). docs/shadows.md#fields.
//
// Exact up to a bound, which is more than any cell beside the discs' common outline has: what is
// farther away is of no use for the zero contour, and leaving it out spares most of the work. Rows
// first, where a site reaches a few cells; then columns, all of them at once, in steps of one cell
// that cost 1, 3, 5, ... (whose sums are the squares).
#pragma once

#include <cstddef>
#include <vector>

namespace penumbra {

// Keeps its memory from one raster to the next.
class PowerTransform {
 public:
  // Width and height of the raster [cells].
  void start(int width, int height);
  // The disc's centre is the cell's; radius >= 0 [cells]. The cell lies in the raster.
  void add(int column, int row, float radius);
  // Computes D from the sites since start().
  void run();

  // What D is where it is more than bound().
  static constexpr float kFar = 1e6F;

  // After run(): D of a row's cells [cells^2].
  [[nodiscard]] const float* row(int index) const {
    return values_.data() + static_cast<std::size_t>(index) * stride_;
  }
  // D is exact up to this, which is more than (r + 1.4)^2 - r^2 of the largest radius.
  [[nodiscard]] float bound() const { return bound_; }

 private:
  struct Site {
    int column, row;
    float radius;
  };

  int width_ = 0, height_ = 0;
  std::size_t stride_ = 0;  // of values_, with room for whole blocks of cells
  float bound_ = 0.0F;
  std::vector<Site> sites_;
  std::vector<float> values_;
  std::vector<float> squares_;  // d^2 for d from -squares_reach_ on
  int squares_reach_ = -1;
  std::vector<float> strips_;  // two copies of a strip of columns
};

}  // namespace penumbra
