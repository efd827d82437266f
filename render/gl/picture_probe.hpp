// What a context does with translucent fragments, found out by drawing some.
#pragma once

#include "core/error.hpp"
#include "render/gl/context.hpp"
#include "render/gl/picture_abilities.hpp"

namespace penumbra {

// Draws a few pixels into a framebuffer of its own, of the picture's kind, and reads them back: by
// what they are, not by what the driver says of itself. Leaves no framebuffer bound. Fails where
// shaders do not compile.
[[nodiscard]] Result<PictureAbilities> probe_picture(GlApi api);

}  // namespace penumbra
