// Discs inside a silhouette along its ridge (docs/shadows.md#kernels). Internal to kernels/.
#pragma once

#include <cstdint>
#include <vector>

#include "render/shadow/kernels/footprint.hpp"

namespace penumbra {

// In cells of the silhouette's raster.
struct Disc {
  float x, y, radius;
};

// Discs in order, each with the distance that it reaches [cells].
class ReachingDiscs {
 public:
  void clear() { discs_.clear(); }
  void add(const Disc& disc) { discs_.push_back(disc); }
  // Discs reach `times` their radius and `slack` further. To be called once all are added.
  void set_reach(float times, float slack);
  [[nodiscard]] const std::vector<Disc>& all() const { return discs_; }
  // The first disc from `disc` on that reaches the point; all().size() where none does.
  [[nodiscard]] std::size_t next_reaching(std::size_t disc, float x, float y) const;
  // The disc from `first` to before `end` that reaches the point and whose centre is nearest to it,
  // in its own radii; the first of equally near ones. Disc `first` must reach the point.
  [[nodiscard]] std::size_t nearest(std::size_t first, std::size_t end, float x, float y);

 private:
  [[nodiscard]] bool reaches(std::size_t disc, float x, float y) const;

  std::vector<Disc> discs_;
  // Whole blocks; those at the end reach nothing.
  std::vector<float> x_, y_, squared_reach_, squared_radius_;
  std::vector<std::int32_t> distances_;
};

// Finds the discs of silhouettes; keeps its memory.
class RidgeDiscs {
 public:
  // Writes the discs, largest first, equal ones in the order of the raster. `slope`: as
  // KernelTuning::ridge_slope. The raster has its depth.
  void find(const FootprintRaster& raster, float slope, ReachingDiscs& discs);

 private:
  [[nodiscard]] Disc disc_at(std::size_t column, std::size_t row, std::size_t stride,
                             float slope) const;
  void sort(ReachingDiscs& discs);

  std::vector<float> ridge_;         // depth of ridge cells, else 0
  std::vector<std::uint8_t> flags_;  // 1 for ridge cells
  std::vector<Disc> found_;          // in the order of the raster
  std::vector<std::uint64_t> keys_;
};

}  // namespace penumbra
