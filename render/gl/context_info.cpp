#include "render/gl/context_info.hpp"

#include <epoxy/gl.h>

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
  for (const std::string_view name : kSoftware)
    info.software = info.software || info.renderer.find(name) != std::string::npos;
  const int core = api == GlApi::gl33 ? 45 : 32;
  if (epoxy_gl_version() >= core || epoxy_has_gl_extension("GL_KHR_robustness")) {
    GLint strategy = GL_NO_RESET_NOTIFICATION;
    glGetIntegerv(GL_RESET_NOTIFICATION_STRATEGY, &strategy);
    info.tells_resets = strategy == GL_LOSE_CONTEXT_ON_RESET;
  }
  return info;
}

}  // namespace penumbra
