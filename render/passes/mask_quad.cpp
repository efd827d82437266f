#include "render/passes/mask_quad.hpp"

#include <algorithm>
#include <array>
#include <string_view>

#include "render/passes/lens_uniforms.hpp"
#include "render/passes/object_pass.hpp"

namespace penumbra {

void MaskTexture::upload(const MaskCells& cells, std::span<const std::uint8_t> codes) {
  texture_.upload(TexelFormat::r8, cells.width, cells.height, codes.data(), cells.width);
  rect_ = {static_cast<float>(cells.size * static_cast<double>(cells.u)),
           static_cast<float>(cells.size * static_cast<double>(cells.v)),
           static_cast<float>(cells.size * cells.width),
           static_cast<float>(cells.size * cells.height)};
}

Result<MaskQuad> MaskQuad::create(GlApi api, double longest_edge_m) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "mask.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFragment = {"mask.frag.glsl"};
  auto program = TranslucentProgram::create(api, kVertex, kFragment, {}, Under::video);
  if (!program) return tl::unexpected(program.error());
  return MaskQuad(std::move(*program), longest_edge_m);
}

void MaskQuad::draw(const MaskTexture& mask, const LensUniforms& lens,
                    const glm::mat4x3& camera_from_plane) const {
  const ShaderProgram& p = program_.get();
  p.use();
  set_lens(p, lens);
  p.set("camera_from_plane", camera_from_plane);
  p.set("mask_rect", mask.rect_);
  p.set("mask", kShadowMaskUnit);
  mask.texture_.bind(kShadowMaskUnit);
  grids_.draw(static_cast<double>(std::max(mask.rect_.z, mask.rect_.w)), longest_edge_m_,
              lens.model == 0);
}

}  // namespace penumbra
