// The contact shade: how dark a plane is around the places where an object touches it
// (docs/shadows.md#contact-shade).
#pragma once

#include "render/shadow/fields/power_distance.hpp"

namespace penumbra {

// Fraction of the light that is left at a place of contact.
inline constexpr double kContactLight = 0.35;

// Returns the reach c of an object's contact shade [m]. `diagonal`: of its box, scaled [m].
[[nodiscard]] double contact_reach(double diagonal);

// Returns a field whose layer `penumbra` is, at each cell, the maximum of r^2 - d^2 [cells^2] over
// the object's points at a height h < c: r = c - max(h, 0) is the radius of the shade around the
// point, d the distance from it in the plane. Its maximum is (c / cell)^2, at places of contact.
[[nodiscard]] ShadowField contact_shade(std::span<const CasterVertex> vertices,
                                        std::span<const std::uint32_t> indices, double reach,
                                        const ShadowFieldOptions& options = {});

}  // namespace penumbra
