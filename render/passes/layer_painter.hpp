// Draws layers of shadows on planes: meshes projected by the vertex shader or on the CPU, and
// fields as textured rectangles.
#pragma once

#include <glm/mat4x3.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <utility>

#include "core/camera/camera_model.hpp"
#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/passes/field_quad.hpp"
#include "render/passes/shadow_geometry.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

class LayerPainter {
 public:
  [[nodiscard]] static Result<LayerPainter> create(GlApi api, const CameraModel& camera);

  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video);

  // The programs that layers are drawn with.
  struct Brush {
    const ShaderProgram& layers;
    const ShaderProgram& field;
    bool penumbra_first = false;
    bool door = false;  // layers are given by places of a screen-door, not by the light left
  };
  // Darkens by the chosen mode.
  [[nodiscard]] Brush darkening() const;
  // Draws plain colour: white for fractions of 1, or marks in the stencil.
  [[nodiscard]] Brush plain() const;

  // To be called before the layers on a plane are drawn.
  void begin_plane(const Brush& brush, const LensUniforms& lens,
                   const glm::mat4x3& camera_from_plane);
  // Number of draw calls.
  int draw(const ShadowDraw& draw, const ShadowItem& item, int first_layer, int count,
           const Brush& brush) const;
  // Draws consecutive whole layers in one instanced call (instances are drawn in order), and those
  // of a field in one rectangle. Number of draw calls.
  int draw_all(const ShadowDraw& draw, const ShadowItem& item, const Brush& brush) const;

 private:
  LayerPainter(TranslucentProgram program, FieldQuad field)
      : program_(std::move(program)), field_quad_(std::move(field)) {}

  TranslucentProgram program_;
  FieldQuad field_quad_;
  Translucency mode_ = Translucency::blend;
};

}  // namespace penumbra
