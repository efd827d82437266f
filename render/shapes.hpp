// Simple shapes as models, for phantoms and tests: closed, outward normals, one material.
#pragma once

#include <glm/vec3.hpp>

#include "render/model.hpp"

namespace penumbra {

// All sizes in metres and > 0. Box and cylinder stand on the origin (z from 0 up), the sphere is
// centred on it.
[[nodiscard]] Model make_box(const glm::vec3& size);
[[nodiscard]] Model make_sphere(float radius, int segments = 48);
[[nodiscard]] Model make_cylinder(float radius, float height, int segments = 48);

}  // namespace penumbra
