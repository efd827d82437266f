// Shadow kernels that move with a mesh while it changes its shape
// (docs/shadows.md#kernels-of-animated-models).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "render/shadow/kernels/shadow_kernels.hpp"

namespace penumbra {

// The kernels of one shape, each with anchors: vertices in the kernel's disc that carry it. The
// weights of its anchors sum to 1 and reproduce the kernel's position, so that an affine motion of
// the anchors moves the kernel in the same way.
class CarriedKernels {
 public:
  // `kernels` were generated for `mesh`; both in the object frame [m].
  CarriedKernels(const ShadowMesh& mesh, ShadowKernels kernels);

  // Returns the kernels for other positions of the same mesh [m]. The positions of the first shape
  // give its kernels, bit by bit. Heights of the others along `up` are not those of their vertices.
  // A kernel that would not be finite is replaced by its vertex.
  [[nodiscard]] ShadowKernels at(std::span<const glm::vec3> positions) const;

  [[nodiscard]] const ShadowKernels& first() const { return first_; }

 private:
  struct Anchor {
    std::uint32_t vertex = 0;
    float weight = 0.0F;
  };
  // A kernel that one or more vertices share.
  struct Site {
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
    std::size_t first = 0, count = 0;  // into anchors_
  };
  void add_anchors(Site& site, std::span<const std::uint32_t> vertices);

  ShadowKernels first_;
  std::vector<glm::vec3> positions_;  // of the first shape
  std::vector<Site> sites_;
  std::vector<Anchor> anchors_;
  std::vector<std::uint32_t> site_of_;  // by position of the mesh
};

// Returns the kernels and radii between two sets of the same mesh. `share` of the second one, 0 to
// 1. The result has radii if both sets have them.
[[nodiscard]] ShadowKernels blended(const ShadowKernels& a, const ShadowKernels& b, double share);

}  // namespace penumbra
