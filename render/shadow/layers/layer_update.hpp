// All three layers of a caster's vertices at once on the CPU: a yardstick for benchmarks and a
// second opinion for tests. The program does not call it: its vertex shader projects where it
// draws, and place_caster with layer_triangles where it writes outlines or casts in a light of one
// size.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "render/shadow/caster.hpp"

namespace penumbra {

// Positions and kernels of a mesh, coordinate by coordinate. Object frame [m].
struct CasterArrays {
  std::vector<float> x, y, z;
  std::vector<float> kx, ky, kz;

  [[nodiscard]] static CasterArrays make(const ShadowMesh& mesh, const ShadowKernels& kernels);
  [[nodiscard]] std::size_t size() const { return x.size(); }
};

// Imaginary vertices (u, v) [m] per layer in the order of kShadowLayers, and heights [m].
struct LayerArrays {
  std::array<std::vector<float>, 3> u, v;
  std::vector<float> h;
};

// Object space to layers, each vertex by itself: heights are clamped to the layer's range where
// clip_to_heights would cut faces. Reuses the memory of `layers`. Same numbers as place_caster and
// project_to_layer, to the rounding of float.
void update_layers(const CasterArrays& caster, const Placement& T_world_object,
                   const PlaneFrame& plane, const LayeredConstants& constants, LayerArrays& layers);

}  // namespace penumbra
