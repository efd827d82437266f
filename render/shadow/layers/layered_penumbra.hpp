// Layered penumbrae: three layers of a shadow along the plane's normal (docs/shadows.md#layers).
//
//   s_lambda(h) = (H + lambda a h) / (H - h),   lambda = -1 umbra, 0 middle, +1 penumbra
//   x_lambda    = k + s_lambda(h) (x - k)
//
// x: vertex, k: its kernel, plane coordinates (u, v); h: height of x above the plane; H: light
// height; a: light ratio. For a light at the zenith (H = inf) whose umbra vanishes at the height
// h_u: s = 1 + lambda h / h_u. shadow.vert.glsl has the same formulas.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "render/scene/layered_constants.hpp"

namespace penumbra {

// The factors return s_lambda(h), the rate ds_lambda/dh [1/m]. h is clamped to the layer's range.
[[nodiscard]] double layer_factor(const LayeredConstants& constants, ShadowLayer layer, double h);
[[nodiscard]] float layer_factor_f(const LayeredConstants& constants, ShadowLayer layer, float h);
[[nodiscard]] double layer_rate(const LayeredConstants& constants, ShadowLayer layer, double h);

// A vertex of a caster in plane coordinates, with its kernel [m].
struct CasterVertex {
  float u = 0.0F, v = 0.0F, h = 0.0F;
  float ku = 0.0F, kv = 0.0F;
};

// Clips triangles to a height range. u, v and k of new vertices are interpolated along the edge; h
// is exactly the clip height, so that their factor is exactly 1 at the plane and 0 at h_u. Ignores
// non-finite faces.
[[nodiscard]] std::vector<CasterVertex> clip_to_heights(std::span<const CasterVertex> vertices,
                                                        std::span<const std::uint32_t> indices,
                                                        const HeightRange& range);

// Returns the projected vertex x_lambda of a caster vertex: (u, v) [m].
struct PlanePoint {
  float u = 0.0F, v = 0.0F;
};
[[nodiscard]] PlanePoint project_to_layer(const CasterVertex& vertex,
                                          const LayeredConstants& constants, ShadowLayer layer);

// Returns a layer's faces, clipped to its heights and projected, three points per triangle. The
// layer is the union of these triangles; they may overlap and have either orientation.
[[nodiscard]] std::vector<PlanePoint> layer_triangles(std::span<const CasterVertex> vertices,
                                                      std::span<const std::uint32_t> indices,
                                                      const LayeredConstants& constants,
                                                      ShadowLayer layer);
// Returns the orthogonal shadow: the faces above the plane, projected along its normal.
[[nodiscard]] std::vector<PlanePoint> orthogonal_triangles(std::span<const CasterVertex> vertices,
                                                           std::span<const std::uint32_t> indices);

}  // namespace penumbra
