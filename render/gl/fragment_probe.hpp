// Tests by drawing which translucency modes work in a context.
#pragma once

#include "core/error.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

// Fragment operations that work in a context.
struct FragmentAbilities {
  bool blends = true;   // multiplying a fragment with the framebuffer
  bool fetches = true;  // reading texels in a fragment shader
};

// Draws a few pixels into a temporary framebuffer and reads them back. Leaves no framebuffer bound.
// Fails if a shader does not compile.
[[nodiscard]] Result<FragmentAbilities> probe_fragment_abilities(GlApi api);

}  // namespace penumbra
