// The bundled models, generated from formulas. Object frame: z up, metres.
#pragma once

#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "render/model/model.hpp"

namespace penumbra::models {

// Positions of the helicopter's rotor hubs in its object frame [m]. The main rotor rotates about z,
// the tail rotor about y.
constexpr glm::dvec3 kMastTop(0.0, 0.0, 0.062);
constexpr glm::dvec3 kTailRotorHub(-0.0785, 0.0052, 0.0515);

[[nodiscard]] Model make_helicopter();
[[nodiscard]] Model make_helicopter_rotor();
[[nodiscard]] Model make_helicopter_tail_rotor();
[[nodiscard]] Model make_sphere();
[[nodiscard]] Model make_cube();
[[nodiscard]] Model make_bar();
[[nodiscard]] Model make_ring();
[[nodiscard]] Model make_l_shape();
[[nodiscard]] Model make_tube();
[[nodiscard]] Model make_tree();
[[nodiscard]] Model make_hand();
[[nodiscard]] Model make_spiral_staircase();

// All bundled models; a model's name is its file name without ".glb".
[[nodiscard]] std::vector<Model> make_bundled_models();

}  // namespace penumbra::models
