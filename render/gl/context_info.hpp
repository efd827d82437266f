// What the current context says of itself.
#pragma once

#include "render/gl/context.hpp"

namespace penumbra {

[[nodiscard]] GlInfo current_gl_info(GlApi api);

}  // namespace penumbra
