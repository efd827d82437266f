// Gives a program the light of a frame: light_count, light_place, light_color, sky_light,
// ground_light and encoding.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <string_view>

#include "render/frame_plan.hpp"
#include "render/gl/shader.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

inline constexpr std::size_t kMaxLights = 8;
// For ShaderProgram::link.
inline constexpr std::array<std::string_view, 1> kLightDefines = {"MAX_LIGHTS 8"};

// `blocked`, the share of each light that is kept away, one per light or none, goes into the fourth
// component of light_color. No more lights than kMaxLights; without any, lamp_of_no_scene().
void set_light_uniforms(const ShaderProgram& program, const FramePlan& plan,
                        std::span<const float> blocked = {});

}  // namespace penumbra
