// Twisted faces: those whose image turns over while a layer shrinks or grows (shadows.md 2.8). With
// coverage by union they do no harm; this counts them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "render/shadow/layered_penumbra.hpp"

namespace penumbra {

struct TwistReport {
  std::size_t faces_tested = 0;  // faces that are not seen edge-on
  std::size_t faces_twisted = 0;
  double area_share = 0.0;  // of the tested faces' projected area
};

// Of the kernels of one shadow in a scene, for a debug view.
struct CasterTwist {
  int node = 0, object = 0, plane = 0;  // indices into the scene
  TwistReport twist;
};

// For every factor from `least` to `greatest`, the same for all corners of a face.
[[nodiscard]] TwistReport find_twists(std::span<const CasterVertex> vertices,
                                      std::span<const std::uint32_t> indices, double least,
                                      double greatest);

}  // namespace penumbra
