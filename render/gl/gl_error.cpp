#include "render/gl/gl_error.hpp"

#include <epoxy/gl.h>
#include <fmt/format.h>

#include "render/gl/context.hpp"

namespace penumbra {

std::optional<unsigned> noted_gl_error(const GlInfo& context) {
  const GLenum first = glGetError();
  // A lost context may report for ever.
  for (int i = 0; first != GL_NO_ERROR && i < 16 && glGetError() != GL_NO_ERROR; ++i) {
  }
  if (context.tells_resets && glGetGraphicsResetStatus() != GL_NO_ERROR) return GL_CONTEXT_LOST;
  if (first == GL_NO_ERROR) return std::nullopt;
  return first;
}

std::string gl_error_text(unsigned code) {
  switch (code) {
    case GL_OUT_OF_MEMORY:
      return "the graphics driver is out of memory; use a smaller picture or smaller models";
    case GL_CONTEXT_LOST:
      return "the graphics driver was reset and has lost all that it was given; start again";
    case GL_INVALID_ENUM:
    case GL_INVALID_VALUE:
    case GL_INVALID_OPERATION:
    case GL_INVALID_FRAMEBUFFER_OPERATION:
      return fmt::format("the graphics driver refuses what it is asked to do (error {:#x})", code);
    default:
      return fmt::format("the graphics driver reports error {:#x}", code);
  }
}

}  // namespace penumbra
