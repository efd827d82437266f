// Twisted faces: faces whose image turns over while a layer shrinks or grows
// (docs/shadows.md#fold-overs).
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

struct TwistReport {
  std::size_t faces_tested = 0;  // faces that are not seen edge-on
  std::size_t faces_twisted = 0;
  double area_share = 0.0;  // of the tested faces' projected area
};

// One shadow of a scene that is made with kernels, for a debug view.
struct CasterKernels {
  int node = 0, object = 0, plane = 0;  // indices into the scene
  TwistReport twist;
  double spill = 0.0;                     // layer_overshoot() of its penumbra
  std::vector<Eigen::Vector3d> on_plane;  // the distinct kernels: table frame [m]
};

// Tests every factor from `least` to `greatest`, the same for all corners of a face.
[[nodiscard]] TwistReport find_twists(std::span<const CasterVertex> vertices,
                                      std::span<const std::uint32_t> indices, double least,
                                      double greatest);

// Overshoot of a layer that grows by one factor > 1: the share outside the outline that a kernel
// for each point of the surface would give. To a cell of 1/192 of the layer's longer side; 0 where
// there is nothing to compare.
[[nodiscard]] double layer_overshoot(const ShadowMesh& mesh, const ShadowKernels& kernels,
                                     double factor);

}  // namespace penumbra
