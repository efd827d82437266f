// Shadow kernels: for each vertex the point k of its part's middle that its layers shrink to and
// grow from (docs/shadows.md#kernels).
#pragma once

#include <Eigen/Core>
#include <atomic>
#include <cstddef>
#include <glm/vec3.hpp>
#include <vector>

#include "render/model/shadow_mesh.hpp"
#include "render/scene/technique.hpp"

namespace penumbra {

struct ShadowKernels {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  // direction d of the kernels, object frame, unit
  // One per ShadowMesh position, object frame [m]; height along d is irrelevant.
  std::vector<glm::vec3> kernels;
  // Radius of the disc at each kernel [m]; empty where the source has none.
  std::vector<float> radius;
};

struct KernelTuning {
  // A vertex belongs to the largest disc inside its part's silhouette that reaches it when grown by
  // this. At least sqrt(2): then the corners of a square share its centre.
  float reach = 1.5F;
  // Discs of this share of the largest one's radius count as equally large.
  float equal_radius = 0.95F;
  // A cell is on a ridge if its depth grows by less than this share of the distance to any
  // neighbour (45 degrees). Neighbours less deep by no more than this are the same ridge.
  float ridge_slope = 0.7F;
  // Cells along each side of a silhouette's raster, were it square, per square root of the part's
  // vertices; within bounds.
  double cells_per_root = 8.0;
  int least_side_cells = 32;
  int most_side_cells = 128;
  // A body of few parts has at least this number of cells in all.
  int cells_of_all = 1 << 17;
};

// Progress of a generation, for another thread to read.
struct KernelProgress {
  std::atomic<std::size_t> done{0}, total{0};  // [vertices]
};

// Any triangle soup gives a finite kernel for every vertex; a vertex without a usable neighbourhood
// gets k = x. `up` must be finite and not zero. A mesh turned about `up` gets turned kernels, to
// 1e-5 of its size; rounding chooses between equal discs.
[[nodiscard]] ShadowKernels generate_kernels(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                             KernelSource source,
                                             KernelProgress* progress = nullptr,
                                             const KernelTuning& tuning = {});

// The size of a part as its light sees it.
struct PartDisc {
  glm::vec3 centre{0.0F};  // of its silhouette: object frame [m], height along `up` irrelevant
  float radius = 0.0F;     // area-weighted median of the local thickness [m]; 0 without area
};
inline constexpr double kHalfFieldCell = 1.0 / 512.0;
// One per part. `finest_cell`: least cell of a silhouette's raster, as a share of the object's
// extent; 0 for as many cells as if each part were the whole object. `across_joints`: measures
// bodies that an author made one part as one, as kernels do. Without it a field shows the light
// between them.
[[nodiscard]] std::vector<PartDisc> part_discs(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                               double finest_cell = kHalfFieldCell,
                                               bool across_joints = true);

// A point of a silhouette with the automatic kernel that a vertex there would have (object frame
// [m], heights along `up` irrelevant). It stands for a square of `side` about it.
struct SilhouettePoint {
  glm::vec3 place{0.0F}, kernel{0.0F};
  float side = 0.0F;
};
// Covers all silhouettes, in cells of about 1 / `cells` of the object's extent.
[[nodiscard]] std::vector<SilhouettePoint> silhouette_points(const ShadowMesh& mesh,
                                                             const Eigen::Vector3d& up, int cells);

}  // namespace penumbra
