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
  Eigen::Vector3d up =
      Eigen::Vector3d::UnitZ();  // direction d that they were made for, object frame, unit
  std::vector<glm::vec3>
      kernels;  // one per ShadowMesh position, object frame [m]; height along d is irrelevant
  std::vector<float>
      radius;  // radius of the disc at the kernel [m]; empty where the source has none
};

// How far a generation is, to be read by another thread.
struct KernelProgress {
  std::atomic<std::size_t> done{0}, total{0};  // [vertices]
};

// Total: any triangle soup gives a finite kernel for every vertex; a vertex without a usable
// neighbourhood gets k = x. `up` need not be unit; it must be finite and not zero.
// Turned about `up` a mesh gets kernels that are turned with it, to 1e-5 of its size and no worse
// than rounding its coordinates would do without a turn: that may choose another of discs that are
// equally large and near (for a few in ten thousand bodies).
[[nodiscard]] ShadowKernels generate_kernels(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                             KernelSource source,
                                             KernelProgress* progress = nullptr);

// A part's size as its light sees it: the area-weighted median of its silhouette's local thickness
// (radius [m], 0 for a part without area), and the centroid of its silhouette (object frame [m],
// height along `up` irrelevant). One per part.
struct PartDisc {
  glm::vec3 centre{0.0F};
  float radius = 0.0F;
};
// Silhouettes of small parts are measured in cells of `finest_cell` of the object's extent, half a
// cell of its shadow field; 0: as finely as if each were the whole object. `across_joints`: bodies
// that an author made one are as thick as all of them are, as for kernels. A light as wide as that
// shines through the joints, which layers of a field show: they are for one as wide as a body.
inline constexpr double kHalfFieldCell = 1.0 / 512.0;
[[nodiscard]] std::vector<PartDisc> part_discs(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                               double finest_cell = kHalfFieldCell,
                                               bool across_joints = true);

// What the silhouette is made of, point by point: where automatic kernels would be for a surface of
// a vertex at every point (object frame [m], heights along `up` irrelevant). Each stands for a
// square of `side` about it.
struct SilhouettePoint {
  glm::vec3 place{0.0F}, kernel{0.0F};
  float side = 0.0F;
};
// In cells of about 1 / `cells` of the object's extent.
[[nodiscard]] std::vector<SilhouettePoint> silhouette_points(const ShadowMesh& mesh,
                                                             const Eigen::Vector3d& up, int cells);

}  // namespace penumbra
