// Shadow kernels: for each vertex, the point k inside its part that the umbra shrinks towards and
// the other layers grow from (docs/shadows.md#kernels).
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
  // Radius of the disc at each kernel [m]; empty if the source has no discs.
  std::vector<float> radius;
};

struct KernelTuning {
  // A vertex belongs to the largest disc in its part's silhouette that contains it when enlarged by
  // this factor. At least sqrt(2), so that the corners of a square share its centre.
  float reach = 1.5F;
  // Discs of at least this fraction of the largest disc's radius count as equally large.
  float equal_radius = 0.95F;
  // A cell is on a ridge if, towards every neighbour, the depth grows by less than this fraction of
  // the distance to it. Adjacent ridge cells are on the same ridge if their depths differ by no
  // more than this [cells].
  float ridge_slope = 0.7F;
  // Side of a square raster [cells] / sqrt(number of the part's vertices), within the next limits.
  double cells_per_root = 8.0;
  int min_side_cells = 32;
  int max_side_cells = 128;
  // Cells shared by all parts: raises the minimum side if a body has few parts.
  int shared_cells = 1 << 17;
};

// Progress of generate_kernels(), read by another thread.
struct KernelProgress {
  std::atomic<std::size_t> done{0}, total{0};  // [vertices]
};

// Returns a finite kernel for every vertex of any triangle soup; a vertex that
// no disc contains is its own kernel. `up` must be finite and not zero. Rotating a mesh about `up`
// rotates its kernels, to 1e-5 of its size, except that rounding decides between equal discs.
[[nodiscard]] ShadowKernels generate_kernels(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                             KernelSource source,
                                             KernelProgress* progress = nullptr,
                                             const KernelTuning& tuning = {});

// The size of a part, seen along `up`, to which the size of its light is proportional.
struct PartDisc {
  // Centre of the silhouette, object frame [m]. Its height along `up` is irrelevant.
  glm::vec3 centre{0.0F};
  float radius = 0.0F;  // area-weighted median of the local thickness [m]; 0 without area
};
inline constexpr double kHalfFieldCell = 1.0 / 512.0;  // half a cell of a field of 256 cells
// Returns one disc per part. `finest_cell`: minimum cell size of a silhouette's raster, as a
// fraction of the object's extent; 0: no minimum. `across_joints`: bridges the joints between
// bodies that a group joined into one part, as kernels do; if false, a field shows the light
// between these bodies.
[[nodiscard]] std::vector<PartDisc> part_discs(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                               double finest_cell = kHalfFieldCell,
                                               bool across_joints = true);

// A sample of a silhouette with the automatic kernel of a vertex at that position (object frame
// [m], heights along `up` irrelevant). It represents a square of side `side` around it.
struct SilhouettePoint {
  glm::vec3 sample_point{0.0F}, kernel{0.0F};
  float side = 0.0F;
};
// Returns samples of the silhouettes of all parts, about 1 / `cells` of the object's extent apart.
[[nodiscard]] std::vector<SilhouettePoint> silhouette_points(const ShadowMesh& mesh,
                                                             const Eigen::Vector3d& up, int cells);

}  // namespace penumbra
