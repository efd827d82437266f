#include "render/passes/translucent_program.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/propagate.hpp"
#include "render/passes/video_texture.hpp"

namespace penumbra {

Result<TranslucentProgram> TranslucentProgram::create(
    GlApi api, std::span<const std::string_view> vertex_files,
    std::span<const std::string_view> fragment_files, std::span<const std::string_view> defines,
    Under under) {
  TranslucentProgram program;
  program.api_ = api;
  program.vertex_files_.assign(vertex_files.begin(), vertex_files.end());
  program.fragment_files_.assign(fragment_files.begin(), fragment_files.end());
  program.defines_.assign(defines.begin(), defines.end());
  program.under_ = under;
  PENUMBRA_TRY(auto blended, program.link({}));
  program.variants_.emplace_back("", std::move(blended));
  return program;
}

Result<ShaderProgram> TranslucentProgram::link(
    std::span<const std::string_view> way_defines) const {
  std::vector<std::string_view> fragment;
  if (std::ranges::find(way_defines, "OVER_VIDEO") != way_defines.end()) {
    fragment.emplace_back("video_texel.glsl");
  }
  fragment.emplace_back("translucency.glsl");
  fragment.insert(fragment.end(), fragment_files_.begin(), fragment_files_.end());
  std::vector<std::string_view> defines = defines_;
  defines.insert(defines.end(), way_defines.begin(), way_defines.end());
  return ShaderProgram::link(api_, vertex_files_, fragment, defines);
}

Result<void> TranslucentProgram::choose(Translucency way, std::optional<PixelFormat> video) {
  std::vector<std::string_view> defines;
  if (way == Translucency::mesh || way == Translucency::geometry_mesh) {
    defines = {"SCREEN_DOOR"};
  } else if (way == Translucency::retexture) {
    defines = {"RETEXTURED"};
    if (under_ == Under::video && video) {
      defines.emplace_back("OVER_VIDEO");
      defines.push_back(layout_define(*video));
    }
  }
  const std::string_view name = defines.empty() ? std::string_view() : defines.back();
  const auto known =
      std::ranges::find(variants_, name, &std::pair<std::string_view, ShaderProgram>::first);
  chosen_ = static_cast<std::size_t>(known - variants_.begin());
  if (known != variants_.end()) return {};
  chosen_ = 0;
  PENUMBRA_TRY(auto linked, link(defines));
  variants_.emplace_back(name, std::move(linked));
  chosen_ = variants_.size() - 1;
  return {};
}

void begin_darkening(Translucency way) {
  if (way != Translucency::blend) {
    glDisable(GL_BLEND);
    return;
  }
  glEnable(GL_BLEND);
  glBlendFunc(GL_ZERO, GL_SRC_COLOR);
}

void begin_summing(Translucency way) {
  if (way != Translucency::blend) {
    glDisable(GL_BLEND);
    return;
  }
  glEnable(GL_BLEND);
  glBlendFunc(GL_ONE, GL_ONE);
  glBlendEquationSeparate(GL_FUNC_ADD, GL_MAX);
}

void begin_mixing(Translucency way) {
  if (way != Translucency::blend) {
    glDisable(GL_BLEND);
    return;
  }
  glEnable(GL_BLEND);
  glBlendFuncSeparate(GL_CONSTANT_ALPHA, GL_ONE_MINUS_CONSTANT_ALPHA, GL_ZERO, GL_ONE);
}

void begin_seeing_through(Translucency way) {
  if (way != Translucency::blend) {
    glDisable(GL_BLEND);
    return;
  }
  glEnable(GL_BLEND);
  glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ZERO, GL_ONE);
}

void set_mixing(Translucency way, const ShaderProgram& program, float opacity) {
  if (way == Translucency::blend) {
    glBlendColor(0.0F, 0.0F, 0.0F, opacity);
  } else {
    program.set("opacity", opacity);
  }
}

void end_translucent() {
  glBlendEquation(GL_FUNC_ADD);
  glDisable(GL_BLEND);
}

float door_places(float light_left) {
  const float lost = 1.0F - std::pow(std::clamp(light_left, 0.0F, 1.0F), 2.2F);
  return std::floor(static_cast<float>(kDoorPlaces) * lost + 0.5F);
}

}  // namespace penumbra
