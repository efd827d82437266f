// Gives a program the scene's lights: light_count, light_place, light_color.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <string_view>

#include "render/gl/shader.hpp"
#include "render/scene.hpp"

namespace penumbra {

inline constexpr std::size_t kMaxLights = 8;
// For ShaderProgram::link.
inline constexpr std::array<std::string_view, 1> kLightDefines = {"MAX_LIGHTS 8"};

// `blocked`, the share of each light that is kept away, one per light or none, goes into the fourth
// component of light_color. No more lights than kMaxLights.
void set_light_uniforms(const ShaderProgram& program, std::span<const PlacedLight> lights,
                        std::span<const float> blocked = {});

}  // namespace penumbra
