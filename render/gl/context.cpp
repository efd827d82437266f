#include "render/gl/context.hpp"

#include <epoxy/gl.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <string_view>

namespace penumbra {

GlInfo current_gl_info(GlApi api) {
  const auto text = [](GLenum name) {
    const auto* bytes = reinterpret_cast<const char*>(glGetString(name));
    return std::string(bytes != nullptr ? bytes : "");
  };
  GlInfo info;
  info.api = api;
  info.renderer = text(GL_RENDERER);
  info.version = text(GL_VERSION);
  constexpr std::array<std::string_view, 4> kSoftware = {"llvmpipe", "softpipe", "swrast",
                                                         "SwiftShader"};
  info.software = std::ranges::any_of(kSoftware, [&info](std::string_view name) {
    return info.renderer.find(name) != std::string::npos;
  });
  const int core = api == GlApi::gl33 ? 45 : 32;
  if (epoxy_gl_version() >= core || epoxy_has_gl_extension("GL_KHR_robustness")) {
    GLint strategy = GL_NO_RESET_NOTIFICATION;
    glGetIntegerv(GL_RESET_NOTIFICATION_STRATEGY, &strategy);
    info.reports_resets = strategy == GL_LOSE_CONTEXT_ON_RESET;
  }
  return info;
}

std::optional<unsigned> take_gl_error(const GlInfo& context) {
  const GLenum first = glGetError();
  // Limits the loop, because a lost context may report errors for ever.
  for (int i = 0; first != GL_NO_ERROR && i < 16 && glGetError() != GL_NO_ERROR; ++i) {
  }
  if (context.reports_resets && glGetGraphicsResetStatus() != GL_NO_ERROR) return GL_CONTEXT_LOST;
  if (first == GL_NO_ERROR) return std::nullopt;
  return first;
}

std::string gl_error_text(unsigned code) {
  switch (code) {
    case GL_OUT_OF_MEMORY:
      return "the graphics driver is out of memory; use a smaller image or smaller models";
    case GL_CONTEXT_LOST:
      return "the graphics driver was reset and lost its data; start again";
    case GL_INVALID_ENUM:
    case GL_INVALID_VALUE:
    case GL_INVALID_OPERATION:
    case GL_INVALID_FRAMEBUFFER_OPERATION:
      return fmt::format("the graphics driver refuses a command (error {:#x})", code);
    default:
      return fmt::format("the graphics driver reports error {:#x}", code);
  }
}

}  // namespace penumbra
