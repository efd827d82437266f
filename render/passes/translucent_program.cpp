#include "render/passes/translucent_program.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>

#include "core/propagate.hpp"
#include "render/passes/video_texture.hpp"

namespace penumbra {

Result<TranslucentProgram> TranslucentProgram::create(GlApi api, ShaderFiles vertex,
                                                      ShaderFiles fragment,
                                                      std::vector<std::string_view> defines,
                                                      Background background) {
  TranslucentProgram program;
  program.api_ = api;
  program.vertex_files_ = std::move(vertex);
  program.fragment_files_ = std::move(fragment);
  program.defines_ = std::move(defines);
  program.background_ = background;
  PENUMBRA_TRY(auto blended, program.link({}));
  program.variants_.emplace_back("", std::move(blended));
  return program;
}

Result<ShaderProgram> TranslucentProgram::link(
    std::span<const std::string_view> mode_defines) const {
  ShaderFiles fragment;
  if (std::ranges::find(mode_defines, "OVER_VIDEO") != mode_defines.end())
    fragment.emplace_back("video_texel.glsl");
  fragment.emplace_back("translucency.glsl");
  fragment.insert(fragment.end(), fragment_files_.begin(), fragment_files_.end());
  std::vector<std::string_view> defines = defines_;
  defines.insert(defines.end(), mode_defines.begin(), mode_defines.end());
  PENUMBRA_TRY(auto program, ShaderProgram::link(api_, vertex_files_, fragment, defines));
  program.use();
  program.set("framebuffer_copy", kFramebufferCopyUnit);
  program.set("sums_copy", kSumsCopyUnit);
  return program;
}

Result<void> TranslucentProgram::choose(Translucency mode, std::optional<PixelFormat> video) {
  std::vector<std::string_view> defines;
  if (mode == Translucency::mesh || mode == Translucency::geometry_mesh) {
    defines = {"SCREEN_DOOR"};
  } else if (mode == Translucency::retexture) {
    defines = {"RETEXTURED"};
    if (background_ == Background::video && video) {
      defines.emplace_back("OVER_VIDEO");
      defines.push_back(layout_define(*video));
    }
  }
  const std::string_view key = defines.empty() ? std::string_view() : defines.back();
  const auto known =
      std::ranges::find(variants_, key, &std::pair<std::string_view, ShaderProgram>::first);
  chosen_ = static_cast<std::size_t>(known - variants_.begin());
  if (known != variants_.end()) return {};
  chosen_ = 0;
  PENUMBRA_TRY(auto linked, link(defines));
  variants_.emplace_back(key, std::move(linked));
  chosen_ = variants_.size() - 1;
  return {};
}

void begin_translucent(Translucency mode, Blending blending) {
  if (mode != Translucency::blend) {
    glDisable(GL_BLEND);
    return;
  }
  glEnable(GL_BLEND);
  switch (blending) {
    case Blending::darken:
      glBlendFunc(GL_ZERO, GL_SRC_COLOR);
      break;
    case Blending::sum:
      glBlendFunc(GL_ONE, GL_ONE);
      glBlendEquationSeparate(GL_FUNC_ADD, GL_MAX);
      break;
    case Blending::mix:
      glBlendFuncSeparate(GL_CONSTANT_ALPHA, GL_ONE_MINUS_CONSTANT_ALPHA, GL_ZERO, GL_ONE);
      break;
    case Blending::see_through:
      glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ZERO, GL_ONE);
      break;
  }
}

void set_mixing(Translucency mode, const ShaderProgram& program, float opacity) {
  if (mode == Translucency::blend) {
    glBlendColor(0.0F, 0.0F, 0.0F, opacity);
  } else {
    program.set("opacity", opacity);
  }
}

void end_translucent() {
  glBlendEquation(GL_FUNC_ADD);
  glDisable(GL_BLEND);
}

float opaque_screen_door_pixels(float factor) {
  const float lost = 1.0F - std::pow(std::clamp(factor, 0.0F, 1.0F), 2.2F);
  return std::floor(static_cast<float>(kScreenDoorPixels) * lost + 0.5F);
}

}  // namespace penumbra
