// Determines the pixels at which each receiving plane is visible. A plane's shadow ends at its
// outline, and a plane hides geometry behind it.
#pragma once

#include <glm/vec4.hpp>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

// Stencil bits.
inline constexpr unsigned kReceiverBit = 0x80U;  // the pixel shows the current plane
inline constexpr unsigned kShadowBits = 0x7FU;   // for the shadow techniques

// Creates the program that darkens a plane by its blocked lights, for Receivers::draw_grid().
[[nodiscard]] Result<TranslucentProgram> plane_light_program(GlApi api);
// Selects the program and sets it up for a plane and its shadow's opacity, except the lights.
void begin_plane_light(const ShaderProgram& program, const FramePlan& plan, const PlaneFrame& plane,
                       float opacity);

// Restores the state before begin_plane() and begin_translucent(); see Pass::draw().
void end_planes();

class Receivers {
 public:
  [[nodiscard]] static Result<Receivers> create(GlApi api, const Scene& scene,
                                                const CameraModel& camera);

  // Starts a frame after the objects are drawn. Draws the planes into the depth buffer if there are
  // several, or if `depth`. Returns the number of draw calls.
  int begin_frame(const FramePlan& plan, const LensUniforms& lens, bool depth);
  // Prepares for drawing on a plane: the plane is visible at pixels that pass the depth test and
  // stencil_test(). Clears all shadow bits.
  void begin_plane(const FramePlan& plan, int plane, const PlaneFrame& frame,
                   const LensUniforms& lens);
  // Passes pixels of the plane whose shadow bits in `compared` equal `bits`. GL_REPLACE writes
  // `bits`.
  void stencil_test(unsigned bits, unsigned compared);
  // Passes all pixels of the plane; disables the stencil test if the plane fills the image.
  void test_plane();
  // Clears the stencil for a pass that uses all bits, until the next begin_plane().
  void clear_stencil();

  // Draws the grid with the current program, which must contain receiver.vert.glsl.
  void draw_grid(const ShaderProgram& program, const FramePlan& plan, const PlaneFrame& frame,
                 const LensUniforms& lens) const;
  // Draws the same depth of a plane as begin_frame(), with the current tests and masks.
  void draw_depth(const FramePlan& plan, const PlaneFrame& frame, const LensUniforms& lens) const;

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
  bool used_ = false;         // the stencil may be non-zero
};

}  // namespace penumbra
