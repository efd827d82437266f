// Finds the pixels that show each receiving plane. A plane's shadow ends at its outline, and each
// of several planes hides what is behind it.
#pragma once

#include <glm/vec4.hpp>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

// Bits of the stencil.
inline constexpr unsigned kReceiverBit = 0x80U;  // the pixel shows the current plane
inline constexpr unsigned kShadowBits = 0x7FU;   // for the techniques

// Makes the program that darkens a plane by the lights that don't reach it, for
// Receivers::draw_grid().
[[nodiscard]] Result<TranslucentProgram> plane_light_program(GlApi api);
// Uses that program for a plane; `opacity`: of the shadow. Its lights are set_lights().
void begin_plane_light(const ShaderProgram& program, const FramePlan& plan, const PlaneFrame& plane,
                       float opacity);

class Receivers {
 public:
  [[nodiscard]] static Result<Receivers> create(GlApi api, const Scene& scene,
                                                const CameraModel& camera);

  // Starts a frame, with depth and stencil as the objects left them. Draws the planes into the
  // depth buffer if there are several, or if `depth`. Returns the number of draw calls.
  int begin_frame(const FramePlan& plan, const LensUniforms& lens, bool depth);
  // Prepares for drawing on a plane: a pixel that passes the depth test and stencil_test() shows
  // the plane. Clears all shadow bits.
  void begin_plane(const FramePlan& plan, int plane, const PlaneFrame& frame,
                   const LensUniforms& lens);
  // Passes the plane's pixels whose shadow bits in `compared` equal `bits`. GL_REPLACE writes
  // `bits`.
  void stencil_test(unsigned bits, unsigned compared);
  // Passes the plane's pixels with any shadow bits; disables the stencil if the plane fills the
  // image.
  void test_place();
  // Clears the stencil for a pass that uses all of its bits, until the next begin_plane().
  void begin_marks();

  // Draws the grid of receiver.vert.glsl with the program in use, which contains it.
  void draw_grid(const ShaderProgram& program, const FramePlan& plan, const PlaneFrame& frame,
                 const LensUniforms& lens) const;
  // Draws the plane's depth with the current tests and masks: the same depth as in begin_frame().
  void draw_place(const FramePlan& plan, const PlaneFrame& frame, const LensUniforms& lens) const;

 private:
  // Inverts kReceiverBit inside the outline.
  void invert_outline(const GlMesh& outline, const FramePlan& plan, const PlaneFrame& frame,
                      const LensUniforms& lens) const;

  ShaderProgram outline_program_;
  ShaderProgram plane_program_;
  std::vector<GlMesh> outlines_;  // one per scene plane; empty: unbounded
  GlMesh grid_{2};
  glm::vec4 view_rect_{0.0F};
  bool depth_drawn_ = false;  // in this frame
  bool marked_ = false;       // kReceiverBit marks the current plane's pixels
  bool used_ = false;         // the stencil is not all 0
};

}  // namespace penumbra
