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

// One field on the GPU, in half floats, which move a zero contour by up to 1/2000 of a cell.
class FieldTexture {
 public:
  explicit FieldTexture(TextureFilter filter = TextureFilter::nearest) : filter_(filter) {}
  void upload(const ShadowField& field);
  // Returns, for each layer, whether it is non-empty.
  [[nodiscard]] const std::array<bool, 3>& layers() const { return layers_; }

 private:
  friend class FieldQuad;
  TextureFilter filter_;
  std::optional<Texture2d> texture_;
  std::array<bool, 3> layers_{};
  // xy: centre of the first texel, zw: extents to the last texel's centre [m]; own frame.
  glm::vec4 rect_{0.0F};
  glm::vec2 last_{0.0F};  // index of the last texel
  std::vector<std::uint16_t> texels_;
};

class FieldQuad {
 public:
  // `fragment`: of the program; field.frag.glsl draws the layers.
  [[nodiscard]] static Result<FieldQuad> create(GlApi api, double longest_edge_m,
                                                ShaderFiles fragment = {"field.frag.glsl"});

  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video) {
    return program_.choose(mode, video);
  }
  [[nodiscard]] const TranslucentProgram& program() const { return program_; }
  // Call it before drawing the fields on a plane; `program`: a variant of program().
  void begin(const ShaderProgram& program, const LensUniforms& lens,
             const glm::mat4x3& camera_from_plane);
  // Darkens each pixel by the darkest wanted layer, with the program of begin(). `layer_light`:
  // each layer's argument of darkened_by_layer() in translucency.glsl.
  void draw(const ShaderProgram& program, const FieldTexture& field,
            const PlanarMotion& T_plane_own, const std::array<bool, 3>& wanted,
            const glm::vec3& layer_light) const;
  // Draws the rectangle of a field, with the program of begin().
  void draw(const ShaderProgram& program, const FieldTexture& field,
            const PlanarMotion& T_plane_own) const;

 private:
  TranslucentProgram program_;
  UnitGrids grids_;
  double longest_edge_m_ = 0.0;  // maximum length of a piece that follows the lens
  bool undistorted_ = false;     // no distortion: one piece is exact
};

}  // namespace penumbra
