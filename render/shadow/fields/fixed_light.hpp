// Layered penumbrae of a light of one size (docs/shadows.md#lights-of-one-size):
//
//   s_lambda(h) = (H + lambda (R_L / R) h) / (H - h)
//
// R is the radius of the disc at the kernel, R_L = a * (median radius of the vertex's part).
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "render/shadow/casters/caster.hpp"
#include "render/shadow/kernels/twist.hpp"

namespace penumbra {

// Radii of a vertex [m]. A vertex without a disc (radius 0) has its kernel at itself.
struct VertexDisc {
  float radius = 0.0F;       // of the disc at the vertex's kernel
  float part_radius = 0.0F;  // of the vertex's part
};

// One per vertex, scaled to the world. `kernels` must have radii.
[[nodiscard]] std::vector<VertexDisc> vertex_discs(const ShadowMesh& mesh,
                                                   const ShadowKernels& kernels,
                                                   std::span<const PartDisc> parts, double scale);

// The imaginary vertices of a layer, one per vertex. Nothing where part of the mesh lies beyond the
// layer's heights: fixed_light_triangles() cuts its faces.
[[nodiscard]] std::optional<std::vector<PlanePoint>> fixed_light_images(
    std::span<const CasterVertex> vertices, std::span<const VertexDisc> discs,
    const LayeredConstants& constants, ShadowLayer layer);

// As layer_triangles(). The umbra is cut where H R = R_L h.
[[nodiscard]] std::vector<PlanePoint> fixed_light_triangles(std::span<const CasterVertex> vertices,
                                                            std::span<const VertexDisc> discs,
                                                            std::span<const std::uint32_t> indices,
                                                            const LayeredConstants& constants,
                                                            ShadowLayer layer);

// Counts the faces that turn over in a layer at their own heights. (find_twists() tests a range of
// factors; here each vertex has its own.)
[[nodiscard]] TwistReport fixed_light_twists(std::span<const CasterVertex> vertices,
                                             std::span<const VertexDisc> discs,
                                             std::span<const std::uint32_t> indices,
                                             const LayeredConstants& constants);

}  // namespace penumbra
