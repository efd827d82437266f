// Draws a shadow field as one textured rectangle on its plane.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/gl/texture.hpp"
#include "render/passes/layers/unit_grids.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/layers/own_frame.hpp"

namespace penumbra {

// One field on the GPU, in half floats: they move a zero contour by at most 1/2000 of a cell.
class FieldTexture {
 public:
  void upload(const ShadowField& field);
  // Returns for each layer whether it is not empty.
  [[nodiscard]] const std::array<bool, 3>& layers() const { return layers_; }

 private:
  friend class FieldQuad;
  std::optional<Texture2d> texture_;
  std::array<bool, 3> layers_{};
  glm::vec4 rect_{0.0F};  // centre of the first texel, extents to the last one's [m], own frame
  glm::vec2 last_{0.0F};  // index of the last texel
  std::vector<std::uint16_t> texels_;
};

class FieldQuad {
 public:
  [[nodiscard]] static Result<FieldQuad> create(GlApi api, double longest_edge_m);

  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video) {
    return program_.choose(mode, video);
  }
  [[nodiscard]] const TranslucentProgram& program() const { return program_; }
  // To be called before the fields on a plane are drawn, with one of program()'s.
  void begin(const ShaderProgram& program, const LensUniforms& lens,
             const glm::mat4x3& camera_from_plane);
  // Darkens by the darkest of the wanted layers, with begin()'s program. `layer_light`: each
  // layer's argument of darkened_by_layer() in translucency.glsl.
  void draw(const ShaderProgram& program, const FieldTexture& field,
            const PlanarMotion& T_plane_own, const std::array<bool, 3>& wanted,
            const glm::vec3& layer_light) const;

 private:
  TranslucentProgram program_;
  UnitGrids grids_;
  double longest_edge_m_ = 0.0;  // of pieces that follow the lens
  bool straight_ = false;        // no distortion: one piece is exact
};

}  // namespace penumbra
