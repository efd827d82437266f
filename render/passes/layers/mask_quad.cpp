#include "render/passes/layers/mask_quad.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "core/propagate.hpp"
#include "core/vector_clones.hpp"
#include "render/passes/object_painter.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

// A coarser grid draws too many cells without effect; a finer grid costs more than it saves.
constexpr std::size_t kMinGrid = 4;

PENUMBRA_VECTOR_CLONES
void keep_minimum(const std::uint8_t* codes, std::size_t count, std::uint8_t* low) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // two arrays
#endif
  for (std::size_t i = 0; i < count; ++i) low[i] = codes[i] < low[i] ? codes[i] : low[i];
}

}  // namespace

void MaskTexture::upload(const MaskCells& cells, std::span<const std::uint8_t> codes) {
  texture_.upload(TexelFormat::r8, cells.width, cells.height, codes.data(), cells.width);
  rect_ = {static_cast<float>(cells.size * static_cast<double>(cells.u)),
           static_cast<float>(cells.size * static_cast<double>(cells.v)),
           static_cast<float>(cells.size * cells.width),
           static_cast<float>(cells.size * cells.height)};
  grid_.reset();
  // A piece depends on its cells and, by interpolation, on their neighbours.
  const auto width = static_cast<std::size_t>(cells.width);
  const auto cells_of = [](std::size_t piece, std::size_t count) {
    const std::size_t first = piece * count / kPieces;
    const std::size_t end = ((piece + 1) * count + kPieces - 1) / kPieces;
    return std::pair(first - std::min<std::size_t>(first, 1), std::min(end + 1, count));
  };
  min_in_column_.resize(width);
  for (std::size_t piece_row = 0; piece_row < kPieces; ++piece_row) {
    const auto [first, end] = cells_of(piece_row, static_cast<std::size_t>(cells.height));
    std::ranges::fill(min_in_column_, std::uint8_t{255});
    for (std::size_t row = first; row < end; ++row)
      keep_minimum(codes.data() + row * width, width, min_in_column_.data());
    darkens_[piece_row] = 0;
    for (std::size_t column = 0; column < kPieces; ++column) {
      const auto [left, right] = cells_of(column, width);
      const auto begin = min_in_column_.begin();
      const bool dark = std::any_of(begin + static_cast<std::ptrdiff_t>(left),
                                    begin + static_cast<std::ptrdiff_t>(right),
                                    [](std::uint8_t code) { return code != 255; });
      darkens_[piece_row] |= static_cast<std::uint64_t>(dark) << column;
    }
  }
}

Result<MaskQuad> MaskQuad::create(GlApi api, double longest_edge_m) {
  MaskQuad quad;
  PENUMBRA_TRY(quad.program_,
               TranslucentProgram::create(api, {"lens.glsl", "mask.vert.glsl"}, {"mask.frag.glsl"},
                                          {}, Background::video));
  quad.longest_edge_m_ = longest_edge_m;
  return quad;
}

int MaskQuad::draw(MaskTexture& mask, const LensUniforms& lens,
                   const glm::mat4x3& camera_from_plane, bool all_pieces) const {
  const ShaderProgram& p = program_.get();
  p.use();
  set_lens(p, lens);
  p.set("camera_from_plane", camera_from_plane);
  p.set("mask_rect", mask.rect_);
  p.set("mask", kShadowMaskUnit);
  mask.texture_.bind(kShadowMaskUnit);

  // The permitted length of pieces grows with the depth.
  float nearest = std::numeric_limits<float>::infinity();
  for (const glm::vec2& corner :
       {glm::vec2(0, 0), glm::vec2(1, 0), glm::vec2(0, 1), glm::vec2(1)}) {
    const glm::vec2 at = glm::vec2(mask.rect_) + corner * glm::vec2(mask.rect_.z, mask.rect_.w);
    nearest = std::min(nearest, (camera_from_plane * glm::vec4(at, 0.0F, 1.0F)).z);
  }
  const double depth = std::max(static_cast<double>(nearest), kNearestDistance);
  const auto size = static_cast<double>(std::max(mask.rect_.z, mask.rect_.w));
  // Without distortion one piece is cheapest.
  const std::size_t grid =
      lens.model == 0
          ? 0
          : std::max(kMinGrid,
                     UnitGrids::grid_for(size, longest_edge_m_ * depth / kNearestDistance, false));
  if (mask.grid_ != grid || mask.all_ != all_pieces) {
    mask.grid_ = grid;
    mask.all_ = all_pieces;
    const auto shift = static_cast<unsigned>(UnitGrids::kGrids - 1 - grid);
    const std::uint64_t piece_bits =
        grid == 0 ? ~std::uint64_t{0} : (std::uint64_t{1} << (1U << shift)) - 1;
    std::vector<std::uint32_t> indices;
    for (std::uint32_t row = 0; row < 1U << grid; ++row) {
      std::uint64_t darkens = 0;
      for (std::uint32_t i = row << shift; i < (row + 1) << shift; ++i) darkens |= mask.darkens_[i];
      for (std::uint32_t column = 0; column < 1U << grid; ++column) {
        if (!all_pieces && (darkens >> (column << shift) & piece_bits) == 0) continue;
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
