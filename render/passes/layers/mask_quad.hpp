// Draws a mask as a textured rectangle on its plane, or only its pieces that have an effect.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/gl/texture.hpp"
#include "render/passes/layers/unit_grids.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/shadow/masks/silhouette_mask.hpp"

namespace penumbra {

class MaskTexture {
 public:
  // `codes`: mask values of MaskRaster::finish().
  void upload(const MaskCells& cells, std::span<const std::uint8_t> codes);

 private:
  friend class MaskQuad;
  static constexpr std::size_t kPieces = std::size_t{1} << (UnitGrids::kGrids - 1);

  Texture2d texture_{TextureFilter::linear};
  glm::vec4 rect_{0.0F};  // xy: corner, zw: extents on the plane [m]
  // One bit for each piece of the finest grid, row by row: whether it has an effect.
  std::array<std::uint64_t, kPieces> darkens_{};
  std::vector<std::uint8_t> min_in_column_;  // over a piece's rows
  // The most recently drawn grid and its pieces.
  VertexArray layout_;
  GlBuffer indices_{BufferUse::indices};
  std::optional<std::size_t> grid_;
  bool all_ = false;
  int index_count_ = 0;
};

class MaskQuad {
 public:
  [[nodiscard]] static Result<MaskQuad> create(GlApi api, double longest_edge_m);

  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video) {
    return program_.choose(mode, video);
  }
  [[nodiscard]] const ShaderProgram& program() const { return program_.get(); }
  // Returns the number of skipped pieces. `all_pieces`: skips none; the image is the same.
  int draw(MaskTexture& mask, const LensUniforms& lens, const glm::mat4x3& camera_from_plane,
           bool all_pieces) const;

 private:
  TranslucentProgram program_;
  UnitGrids grids_;
  double longest_edge_m_ = 0.0;  // maximum length of pieces at kNearestDistance
};

}  // namespace penumbra
