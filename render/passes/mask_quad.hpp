// Draws a MaskPicture as a textured rectangle on its plane, or those pieces of it that darken
// anything.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/passes/unit_grids.hpp"
#include "render/shadow/masks/silhouette_mask.hpp"

namespace penumbra {

// One mask on the GPU.
class MaskTexture {
 public:
  // `codes`: of finish(), rows in order.
  void upload(const MaskCells& cells, std::span<const std::uint8_t> codes);

 private:
  friend class MaskQuad;
  static constexpr std::size_t kPieces = std::size_t{1} << (UnitGrids::kGrids - 1);

  Texture2d texture_{TextureFilter::linear};
  glm::vec4 rect_{0.0F};  // corner and extents [m], plane
  // Of the finest grid's pieces, row by row, a bit each: whether it darkens anything.
  std::array<std::uint64_t, kPieces> darkens_{};
  std::vector<std::uint8_t> darkest_in_column_;  // of some rows
  // Those of the grid that was drawn last.
  VertexArray layout_;
  GlBuffer indices_{BufferUse::indices};
  std::optional<std::size_t> grid_;
  bool all_ = false;
  int index_count_ = 0;
};

// How a mask is drawn. The pictures are the same: to the bit, and to 0.15 px.
struct MaskPieces {
  bool all = false;     // also those that darken nothing
  bool finest = false;  // as short as the nearest distance expected asks for, whatever the present
};

class MaskQuad {
 public:
  [[nodiscard]] static Result<MaskQuad> create(GlApi api, double longest_edge_m);

  [[nodiscard]] Result<void> choose(Translucency way, std::optional<PixelFormat> video) {
    return program_.choose(way, video);
  }
  [[nodiscard]] const ShaderProgram& program() const { return program_.get(); }
  // How many pieces were left out.
  int draw(MaskTexture& mask, const LensUniforms& lens, const glm::mat4x3& camera_from_plane,
           const MaskPieces& pieces) const;

 private:
  MaskQuad(TranslucentProgram program, double longest_edge_m)
      : program_(std::move(program)), longest_edge_m_(longest_edge_m) {}

  TranslucentProgram program_;
  UnitGrids grids_;
  // At the nearest distance expected pieces are no longer than this, so that they follow the lens.
  double longest_edge_m_ = 0.0;
};

}  // namespace penumbra
