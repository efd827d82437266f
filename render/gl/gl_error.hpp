// Errors that OpenGL notes, for people.
#pragma once

#include <optional>
#include <string>

namespace penumbra {

struct GlInfo;

// The first error that OpenGL has noted since it was last asked, if any; the rest are of the same
// cause and dropped. A reset of the driver is GL_CONTEXT_LOST, whatever else was noted.
[[nodiscard]] std::optional<unsigned> noted_gl_error(const GlInfo& context);

// What it means, and what to do where somebody can.
[[nodiscard]] std::string gl_error_text(unsigned code);

}  // namespace penumbra
