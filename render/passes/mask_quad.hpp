// Draws a MaskPicture as one textured rectangle on its plane.
#pragma once

#include <cstdint>
#include <span>

#include "render/camera_gl.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/passes/unit_grids.hpp"
#include "render/shadow/silhouette_mask.hpp"

namespace penumbra {

// One mask on the GPU.
class MaskTexture {
 public:
  // `codes`: of finish(), rows in order.
  void upload(const MaskCells& cells, std::span<const std::uint8_t> codes);

 private:
  friend class MaskQuad;
  Texture2d texture_{TextureFilter::linear};
  glm::vec4 rect_{0.0F};  // corner and extents [m], plane
};

class MaskQuad {
 public:
  [[nodiscard]] static Result<MaskQuad> create(GlApi api, double longest_edge_m);

  [[nodiscard]] Result<void> choose(Translucency way, std::optional<PixelFormat> video) {
    return program_.choose(way, video);
  }
  [[nodiscard]] const ShaderProgram& program() const { return program_.get(); }
  void draw(const MaskTexture& mask, const LensUniforms& lens,
            const glm::mat4x3& camera_from_plane) const;

 private:
  MaskQuad(TranslucentProgram program, double longest_edge_m)
      : program_(std::move(program)), longest_edge_m_(longest_edge_m) {}

  TranslucentProgram program_;
  UnitGrids grids_;
  double longest_edge_m_ = 0.0;  // pieces are no longer than this, so that they follow the lens
};

}  // namespace penumbra
