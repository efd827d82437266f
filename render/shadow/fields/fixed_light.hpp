// Layered penumbrae of LightMode::fixed (docs/shadows.md#lights-of-one-size). In layer lambda, a
// vertex at the height h is scaled about its kernel by
//   s_lambda(h) = (H + lambda (R_L / R) h) / (H - h)
// H: light height. R: radius of the disc at the kernel. R_L = a * (median disc radius of the
// vertex's part).
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "render/shadow/casters/caster.hpp"
#include "render/shadow/kernels/twist.hpp"

namespace penumbra {

// Radii of a vertex [m]. A vertex without a disc (radius 0) is its own kernel.
struct VertexDisc {
  float radius = 0.0F;       // radius of the disc at the vertex's kernel
  float part_radius = 0.0F;  // PartDisc::radius of the vertex's part
};

// Returns the radii of each vertex, scaled to the world. `kernels` must have radii.
[[nodiscard]] std::vector<VertexDisc> vertex_discs(const ShadowMesh& mesh,
                                                   const ShadowKernels& kernels,
                                                   std::span<const PartDisc> parts, double scale);

// Returns the projected vertices of a layer, one per vertex; nullopt if the mesh exceeds the
// layer's height range, in which case fixed_light_triangles() must clip its faces.
[[nodiscard]] std::optional<std::vector<PlanePoint>> fixed_light_images(
    std::span<const CasterVertex> vertices, std::span<const VertexDisc> discs,
    const LayeredConstants& constants, ShadowLayer layer);

// Like layer_triangles(). The umbra is clipped at heights where H R = R_L h.
[[nodiscard]] std::vector<PlanePoint> fixed_light_triangles(std::span<const CasterVertex> vertices,
                                                            std::span<const VertexDisc> discs,
                                                            std::span<const std::uint32_t> indices,
                                                            const LayeredConstants& constants,
                                                            ShadowLayer layer);

// Counts the faces that fold over in a layer. The factor is evaluated at the height of each vertex;
// find_twists() tests a range of factors common to a face.
[[nodiscard]] TwistReport fixed_light_twists(std::span<const CasterVertex> vertices,
                                             std::span<const VertexDisc> discs,
                                             std::span<const std::uint32_t> indices,
                                             const LayeredConstants& constants);

}  // namespace penumbra
