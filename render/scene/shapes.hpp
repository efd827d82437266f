// Creates simple shapes: closed, centred at the origin, z up, metres.
#pragma once

#include <glm/vec3.hpp>

#include "render/model/model.hpp"

namespace penumbra {

[[nodiscard]] Model make_box(const glm::vec3& size);
[[nodiscard]] Model make_sphere(float radius);
[[nodiscard]] Model make_cylinder(float radius, float height);  // its axis is z
[[nodiscard]] Model make_ring(float radius, float thickness);   // a torus about z

}  // namespace penumbra
