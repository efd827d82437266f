// Draws shadow layers on planes: fields, and meshes projected by the vertex shader or the CPU.
#pragma once

#include <optional>

#include "render/passes/layers/field_quad.hpp"
#include "render/passes/layers/shadow_geometry.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

class LayerPainter {
 public:
  [[nodiscard]] static Result<LayerPainter> create(GlApi api, const CameraModel& camera);

  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video);

  // The programs for layers.
  struct Brush {
    const ShaderProgram& layers;
    const ShaderProgram& field;
    bool penumbra_first = false;
    bool door = false;  // layer values: numbers of opaque screen-door pixels, not light left
  };
  // Darkens in the chosen mode.
  [[nodiscard]] Brush darkening() const;
  // Draws a layer's fraction of light as a grey level; 1 is white.
  [[nodiscard]] Brush plain() const;

  // Call it before drawing the layers on a plane.
  void begin_plane(const Brush& brush, const LensUniforms& lens,
                   const glm::mat4x3& camera_from_plane);
  // Draws `count` consecutive layers with the same source. Returns the number of draw calls.
  int draw(const ShadowDraw& draw, const ShadowItem& item, int first_layer, int count,
           const Brush& brush) const;
  // Draws consecutive whole layers in one instanced call (instances are drawn in order), and the
  // layers of a field as one rectangle. Returns the number of draw calls.
  int draw_all(const ShadowDraw& draw, const ShadowItem& item, const Brush& brush) const;

 private:
  TranslucentProgram program_;
  FieldQuad field_quad_;
  Translucency mode_ = Translucency::blend;
};

}  // namespace penumbra
