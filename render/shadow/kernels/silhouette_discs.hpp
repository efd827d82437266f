// Discs inside a silhouette along its ridge (docs/shadows.md#kernels). Internal to kernels/.
#pragma once

#include <cstdint>
#include <vector>

#include "render/shadow/kernels/footprint.hpp"

namespace penumbra {

// Centre and radius in cells of the silhouette's raster.
struct Disc {
  float x, y, radius;
};

// An ordered list of discs. A disc reaches points within a set distance of its centre [cells].
class ReachingDiscs {
 public:
  void clear() { discs_.clear(); }
  void add(const Disc& disc) { discs_.push_back(disc); }
  // Sets the distance that each disc reaches: `times` its radius plus `slack`. Call after add().
  void set_reach(float times, float slack);
  [[nodiscard]] const std::vector<Disc>& all() const { return discs_; }
  // Returns the first disc from index `disc` on that reaches the point, or all().size().
  [[nodiscard]] std::size_t next_reaching(std::size_t disc, float x, float y) const;
  // Among the discs [first, end) that reach the point, returns the one with the smallest distance /
  // radius; the first disc if several are equal. Disc `first` must reach the point.
  [[nodiscard]] std::size_t nearest(std::size_t first, std::size_t end, float x, float y);

 private:
  [[nodiscard]] bool reaches(std::size_t disc, float x, float y) const;

  std::vector<Disc> discs_;
  // Padded to whole SIMD blocks; padding discs reach no point.
  std::vector<float> x_, y_, squared_reach_, squared_radius_;
  std::vector<std::int32_t> distances_;
};

// Finds the discs of silhouettes; reuses its memory.
class RidgeDiscs {
 public:
  // Writes the discs, largest first; equal discs stay in raster order. `slope`: see
  // KernelTuning::ridge_slope. Requires raster.compute_depth().
  void find(const FootprintRaster& raster, float slope, ReachingDiscs& discs);

 private:
  [[nodiscard]] Disc disc_at(std::size_t column, std::size_t row, std::size_t stride,
                             float slope) const;
  void sort(ReachingDiscs& discs);

  std::vector<float> ridge_;         // depth of ridge cells, else 0
  std::vector<std::uint8_t> flags_;  // 1 for ridge cells
  std::vector<Disc> found_;          // in raster order
  std::vector<std::uint64_t> keys_;
};

}  // namespace penumbra
