#include "render/gl/picture_probe.hpp"

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
constexpr std::size_t kBytes = std::size_t{4} * kSide * kSide;
using Pixels = std::array<std::uint8_t, kBytes>;

// Codes per channel: a factor of these over another three.
constexpr std::array<int, 3> kBefore = {200, 120, 40};
constexpr std::array<int, 3> kFactor = {128, 255, 64};

glm::vec4 color_of(const std::array<int, 3>& codes) {
  const auto part = [&codes](std::size_t i) { return static_cast<float>(codes[i]) / 255.0F; };
  return {part(0), part(1), part(2), 1.0F};
}

bool are_product(const Pixels& pixels) {
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const std::size_t channel = i % 4;
    if (channel == 3) continue;
    const int expected = (kBefore[channel] * kFactor[channel] + 127) / 255;
    if (std::abs(static_cast<int>(pixels[i]) - expected) > 1) return false;
  }
  return true;
}

}  // namespace

Result<PictureAbilities> probe_picture(GlApi api) {
  constexpr std::array<std::string_view, 1> kWhole = {"video.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFill = {"fill.frag.glsl"};
  constexpr std::array<std::string_view, 2> kVideo = {"video_texel.glsl", "video.frag.glsl"};
  constexpr std::array<std::string_view, 1> kRgb = {"VIDEO_RGB"};
  PENUMBRA_TRY(auto framebuffer, Framebuffer::create(kSide, kSide));
  PENUMBRA_TRY(const auto fill, ShaderProgram::link(api, kWhole, kFill));
  PENUMBRA_TRY(const auto fetch, ShaderProgram::link(api, kWhole, kVideo, kRgb));
  const VertexArray no_vertices;
  framebuffer.bind();
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_BLEND);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  no_vertices.bind();

  PictureAbilities abilities;
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

  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const std::size_t channel = i % 4;
    pixels[i] = channel == 3
                    ? std::uint8_t{255}
                    : static_cast<std::uint8_t>((kBefore[channel] * kFactor[channel] + 127) / 255);
  }
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
