#include "render/passes/mask_quad.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <limits>
#include <string_view>
#include <utility>

#include "core/propagate.hpp"
#include "core/vector_clones.hpp"
#include "render/passes/lens_uniforms.hpp"
#include "render/passes/object_painter.hpp"

namespace penumbra {
namespace {

// With fewer pieces too much of what darkens nothing is drawn; more cost more than they spare.
constexpr std::size_t kLeastGrid = 4;

PENUMBRA_VECTOR_CLONES
void take_least(const std::uint8_t* codes, std::size_t count, std::uint8_t* least) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // two arrays
#endif
  for (std::size_t i = 0; i < count; ++i) least[i] = codes[i] < least[i] ? codes[i] : least[i];
}

}  // namespace

void MaskTexture::upload(const MaskCells& cells, std::span<const std::uint8_t> codes) {
  texture_.upload(TexelFormat::r8, cells.width, cells.height, codes.data(), cells.width);
  rect_ = {static_cast<float>(cells.size * static_cast<double>(cells.u)),
           static_cast<float>(cells.size * static_cast<double>(cells.v)),
           static_cast<float>(cells.size * cells.width),
           static_cast<float>(cells.size * cells.height)};
  grid_.reset();
  // A piece shows its cells and, between their middles, the next ones.
  const auto width = static_cast<std::size_t>(cells.width);
  const auto cells_of = [](std::size_t piece, std::size_t count) {
    const std::size_t first = piece * count / kPieces;
    const std::size_t end = ((piece + 1) * count + kPieces - 1) / kPieces;
    return std::pair(first - std::min<std::size_t>(first, 1), std::min(end + 1, count));
  };
  darkest_in_column_.resize(width);
  for (std::size_t piece_row = 0; piece_row < kPieces; ++piece_row) {
    const auto [first, end] = cells_of(piece_row, static_cast<std::size_t>(cells.height));
    std::ranges::fill(darkest_in_column_, std::uint8_t{255});
    for (std::size_t row = first; row < end; ++row)
      take_least(codes.data() + row * width, width, darkest_in_column_.data());
    darkens_[piece_row] = 0;
    for (std::size_t column = 0; column < kPieces; ++column) {
      const auto [left, right] = cells_of(column, width);
      const auto begin = darkest_in_column_.begin();
      const bool dark = std::any_of(begin + static_cast<std::ptrdiff_t>(left),
                                    begin + static_cast<std::ptrdiff_t>(right),
                                    [](std::uint8_t code) { return code != 255; });
      darkens_[piece_row] |= static_cast<std::uint64_t>(dark) << column;
    }
  }
}

Result<MaskQuad> MaskQuad::create(GlApi api, double longest_edge_m) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "mask.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFragment = {"mask.frag.glsl"};
  PENUMBRA_TRY(auto program, TranslucentProgram::create(api, kVertex, kFragment, {}, Under::video));
  return MaskQuad(std::move(program), longest_edge_m);
}

int MaskQuad::draw(MaskTexture& mask, const LensUniforms& lens,
                   const glm::mat4x3& camera_from_plane, const MaskPieces& pieces) const {
  const ShaderProgram& p = program_.get();
  p.use();
  set_lens(p, lens);
  p.set("camera_from_plane", camera_from_plane);
  p.set("mask_rect", mask.rect_);
  p.set("mask", kShadowMaskUnit);
  mask.texture_.bind(kShadowMaskUnit);

  // Longer farther away.
  double depth = kNearestDistance;
  if (!pieces.finest) {
    float nearest = std::numeric_limits<float>::infinity();
    for (const glm::vec2& corner :
         {glm::vec2(0, 0), glm::vec2(1, 0), glm::vec2(0, 1), glm::vec2(1)}) {
      const glm::vec2 at = glm::vec2(mask.rect_) + corner * glm::vec2(mask.rect_.z, mask.rect_.w);
      nearest = std::min(nearest, (camera_from_plane * glm::vec4(at, 0.0F, 1.0F)).z);
    }
    depth = std::max(static_cast<double>(nearest), kNearestDistance);
  }
  const auto size = static_cast<double>(std::max(mask.rect_.z, mask.rect_.w));
  // Without a lens to follow one piece is cheapest: what it darkens nothing of costs less than the
  // corners of many.
  const bool straight = lens.model == 0;
  const std::size_t grid =
      straight ? 0
               : std::max(kLeastGrid, UnitGrids::grid_for(
                                          size, longest_edge_m_ * depth / kNearestDistance, false));
  if (mask.grid_ != grid || mask.all_ != pieces.all) {
    mask.grid_ = grid;
    mask.all_ = pieces.all;
    const auto shift = static_cast<unsigned>(UnitGrids::kGrids - 1 - grid);
    const std::uint64_t a_piece =
        grid == 0 ? ~std::uint64_t{0} : (std::uint64_t{1} << (1U << shift)) - 1;
    std::vector<std::uint32_t> indices;
    for (std::uint32_t row = 0; row < 1U << grid; ++row) {
      std::uint64_t darkens = 0;
      for (std::uint32_t i = row << shift; i < (row + 1) << shift; ++i) darkens |= mask.darkens_[i];
      for (std::uint32_t column = 0; column < 1U << grid; ++column) {
        if (!pieces.all && (darkens >> (column << shift) & a_piece) == 0) continue;
        for (const std::uint32_t index : UnitGrids::piece(grid, row, column))
          indices.push_back(index);
      }
    }
    mask.layout_.bind();
    grids_.bind_corners(grid);
    mask.indices_.write(std::span<const std::uint32_t>(indices), BufferLife::every_frame);
    mask.index_count_ = static_cast<int>(indices.size());
  }
  mask.layout_.bind();
  glDrawElements(GL_TRIANGLES, mask.index_count_, GL_UNSIGNED_INT, nullptr);
  return (1 << 2 * grid) - mask.index_count_ / 6;
}

}  // namespace penumbra
