// Twisted faces: those whose image turns over while a layer shrinks or grows
// (docs/shadows.md#fold-overs). With coverage by union they open no hole; this counts them, and
// measures what they cover too much.
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
  double spill = 0.0;                     // of its penumbra, by layer_spill()
  std::vector<Eigen::Vector3d> on_plane;  // where the kernels are: table frame [m], each once
};

// For every factor from `least` to `greatest`, the same for all corners of a face.
[[nodiscard]] TwistReport find_twists(std::span<const CasterVertex> vertices,
                                      std::span<const std::uint32_t> indices, double least,
                                      double greatest);

// Spill: the share of a growing layer (factor > 1 for all vertices alike) that lies outside of the
// outline which every point of the surface would draw by itself with an automatic kernel of its
// own: what faces between different kernels cover too much, turned over or not. To a cell of 1/192
// of the layer's longer side. 0 where there is nothing to compare.
[[nodiscard]] double layer_spill(const ShadowMesh& mesh, const ShadowKernels& kernels,
                                 double factor);

}  // namespace penumbra
