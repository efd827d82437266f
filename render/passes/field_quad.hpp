// Draws a shadow field as one textured rectangle on its plane.
#pragma once

#include <array>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <optional>

#include "render/camera_gl.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/passes/unit_grids.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/layers/own_frame.hpp"

namespace penumbra {

// One field on the GPU, in half floats: a zero contour is where it was to 1/2000 of a cell.
class FieldTexture {
 public:
  void upload(const ShadowField& field);
  // Which layers the field has anything of.
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

  [[nodiscard]] Result<void> choose(Translucency way, std::optional<PixelFormat> video) {
    return program_.choose(way, video);
  }
  [[nodiscard]] const TranslucentProgram& program() const { return program_; }
  // Of each plane, before its fields are drawn: with one of program()'s.
  void begin(const ShaderProgram& program, const LensUniforms& lens,
             const glm::mat4x3& camera_from_plane);
  // Darkens to the darkest of the wanted layers, with begin()'s program, which is put in use.
  // `layer_light`: of each layer, for darkened_by_layer() of translucency.glsl.
  void draw(const ShaderProgram& program, const FieldTexture& field,
            const PlanarMotion& T_plane_own, const std::array<bool, 3>& wanted,
            const glm::vec3& layer_light) const;

 private:
  FieldQuad(TranslucentProgram program, double longest_edge_m)
      : program_(std::move(program)), longest_edge_m_(longest_edge_m) {}

  TranslucentProgram program_;
  UnitGrids grids_;
  double longest_edge_m_ = 0.0;  // pieces are no longer than this, so that they follow the lens
  bool straight_ = false;        // the lens has no distortion: one piece is exact
};

}  // namespace penumbra
