// Uniforms that several programs share.
#pragma once

#include <span>
#include <string_view>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/shader.hpp"

namespace penumbra {

// Sets the lens of a program that contains lens.glsl.
void set_lens(const ShaderProgram& program, const LensUniforms& lens);

inline constexpr std::size_t kMaxLights = 8;
// The define of light_share.glsl.
inline constexpr std::string_view kLightDefine = "MAX_LIGHTS 8";

// Sets the eye and the lights of a program that contains light_share.glsl. `blocked`: the blocked
// fraction of each light; empty: none. Uses default_light() for a plan without lights.
void set_lights(const ShaderProgram& program, const FramePlan& plan,
                std::span<const float> blocked = {});

}  // namespace penumbra
