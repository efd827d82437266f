// The constants of automatic shadow kernels (relaxed local thickness, docs/shadows.md#kernels).
// Each is either what a raster can tell, or lies on a plateau:
// tests/benchmarks/kernel_constants_benchmark.cpp varies them, and the kernel_constants section of
// BENCHMARKS.md has its figures. (They do not tell least_side_cells, for parts of few vertices.)
#pragma once

#include <Eigen/Core>

#include "render/shadow/kernels/shadow_kernels.hpp"

namespace penumbra {

struct KernelTuning {
  // A vertex belongs to the largest disc inside its part's silhouette that reaches it when grown by
  // this. At least sqrt(2): the corners of a square then share its centre, so that a cube scales as
  // a cube.
  float reach = 1.5F;
  // Discs this close to the largest count as equally large; of those the one that is nearest, in
  // its own radii, wins.
  float equal_radius = 0.95F;
  // A cell whose depth grows by less than this share of the distance to any neighbour is on a
  // ridge: of less than 45 degrees. Neighbours of a ridge cell that are less deep by no more than
  // that are the same ridge, seen in two rows of cells.
  float ridge_slope = 0.7F;
  // A silhouette's raster has this many cells along each side (were it square) per square root of
  // the part's vertices, within bounds.
  double cells_per_root = 8.0;
  int least_side_cells = 32;
  int most_side_cells = 128;
  // Of a body of few parts each has more: as many as all its parts have together. (Half a cell of
  // 32 is 3 % of a disc's radius, and near the umbra's end 9 % of the umbra's area.)
  int cells_of_all = 1 << 17;
};

// As generate_kernels with KernelSource::automatic, which has the usual constants.
[[nodiscard]] ShadowKernels generate_tuned_kernels(const ShadowMesh& mesh,
                                                   const Eigen::Vector3d& up,
                                                   const KernelTuning& tuning);

}  // namespace penumbra
