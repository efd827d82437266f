// Twisted faces: faces whose projection folds over while a layer shrinks or grows
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
  double area_share = 0.0;  // twisted fraction of the tested faces' projected area
};

// One shadow of a scene that uses kernels, for a debug view.
struct CasterKernels {
  int node = 0, object = 0, plane = 0;  // indices into the scene
  TwistReport twist;
  double spill = 0.0;                     // layer_overshoot() of its penumbra
  std::vector<Eigen::Vector3d> on_plane;  // distinct kernels, table frame [m]
};

// Counts faces that fold over at any factor from `low` to `high`; a face's corners share a factor.
[[nodiscard]] TwistReport find_twists(std::span<const CasterVertex> vertices,
                                      std::span<const std::uint32_t> indices, double low,
                                      double high);

// Returns the fraction of a layer, scaled by one factor > 1, that lies outside the ideal outline,
// which has a kernel for each point of the surface. Cells are 1/192 of the layer's longer side.
// Returns 0 for an empty layer.
[[nodiscard]] double layer_overshoot(const ShadowMesh& mesh, const ShadowKernels& kernels,
                                     double factor);

}  // namespace penumbra
