#include "render/gl/fragment_probe.hpp"

#include <epoxy/gl.h>

#include <array>
#include <cstdint>
#include <cstdlib>

#include "core/propagate.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"

namespace penumbra {
namespace {

constexpr int kSide = 4;
using Pixels = std::array<std::uint8_t, std::size_t{4} * kSide * kSide>;

// 8-bit RGBA of the framebuffer (kBefore), of the fragment (kFactor), and of their product.
using Rgba = std::array<int, 4>;
constexpr Rgba kBefore = {200, 120, 40, 255};
constexpr Rgba kFactor = {128, 255, 64, 255};
constexpr int product(std::size_t channel) {
  return (kBefore[channel] * kFactor[channel] + 127) / 255;
}

glm::vec4 color_of(const Rgba& codes) {
  return glm::vec4(codes[0], codes[1], codes[2], codes[3]) / 255.0F;
}

bool are_product(const Pixels& pixels) {
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    if (i % 4 != 3 && std::abs(static_cast<int>(pixels[i]) - product(i % 4)) > 1) return false;
  }
  return true;
}

}  // namespace

Result<FragmentAbilities> probe_fragment_abilities(GlApi api) {
  constexpr std::array<std::string_view, 1> kRgb = {"VIDEO_RGB"};
  PENUMBRA_TRY(auto framebuffer, Framebuffer::create(kSide, kSide));
  PENUMBRA_TRY(const auto fill, ShaderProgram::link(api, {"video.vert.glsl"}, {"fill.frag.glsl"}));
  PENUMBRA_TRY(
      const auto fetch,
      ShaderProgram::link(api, {"video.vert.glsl"}, {"video_texel.glsl", "video.frag.glsl"}, kRgb));
  const VertexArray no_vertices;
  framebuffer.bind();
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_BLEND);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  no_vertices.bind();

  FragmentAbilities abilities;
  Pixels pixels{};
  fill.use();
  fill.set("value", color_of(kBefore));
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ZERO, GL_SRC_COLOR);
  fill.set("value", color_of(kFactor));
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glDisable(GL_BLEND);
  framebuffer.read_rgba(pixels);
  abilities.blends = are_product(pixels);

  for (std::size_t i = 0; i < pixels.size(); ++i)
    pixels[i] = static_cast<std::uint8_t>(product(i % 4));
  Texture2d texture(TextureFilter::nearest);
  texture.upload(TexelFormat::rgba8, kSide, kSide, pixels.data(), std::ptrdiff_t{4} * kSide);
  texture.bind(0);
  fetch.use();
  fetch.set("plane0", 0);
  glDrawArrays(GL_TRIANGLES, 0, 3);
  framebuffer.read_rgba(pixels);
  abilities.fetches = are_product(pixels);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  return abilities;
}

}  // namespace penumbra
