// Gives a program that has lens.glsl in it its lens.
#pragma once

#include "render/camera_gl.hpp"
#include "render/gl/shader.hpp"

namespace penumbra {

inline void set_lens(const ShaderProgram& program, const LensUniforms& lens) {
  program.set("lens_scale_offset", lens.scale_offset);
  program.set("lens_k_low", lens.k_low);
  program.set("lens_k_high", lens.k_high);
  program.set("lens_model", lens.model);
  program.set("lens_max_radius", lens.max_radius);
  program.set("lens_depth", lens.depth);
}

}  // namespace penumbra
