// The planes that shadows fall on, as the picture shows them: which of its pixels are a plane's
// own. A plane's shadow is cut at its outline, and where there are several planes, each hides what
// is behind it.
#pragma once

#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Bits of the stencil.
inline constexpr unsigned kReceiverBit = 0x80U;  // the pixel shows the plane that is drawn on now
inline constexpr unsigned kShadowBits = 0x7FU;   // for the techniques

// 1 / depth [1/m] of a plane in the picture is linear in undistorted normalised coordinates (x, y):
// the product with (x, y, 1). The eye must be in front of the plane.
[[nodiscard]] glm::vec3 inverse_depth(const CameraPose& T_table_camera, const PlaneFrame& plane);

class Receivers {
 public:
  [[nodiscard]] static Result<Receivers> create(GlApi api, const Scene& scene,
                                                const CameraModel& camera);

  // Before the planes of a frame: with depth and stencil as the objects left them. Where there are
  // several planes, or `depth` says that something else needs them, they are put into the depth
  // buffer. Number of draw calls.
  int begin_frame(const FramePlan& plan, const LensUniforms& lens, bool depth);
  // From here on geometry on this plane can be drawn: depth test and stencil are set such that
  // where stencil_test() holds, and the depth test passes if there is one, the pixel is the plane's
  // own. The shadow bits of all pixels are 0.
  void begin_plane(const FramePlan& plan, int plane, const PlaneFrame& frame,
                   const LensUniforms& lens);
  // Passes on the plane's own pixels whose other shadow bits, of those in `compared`, are `bits`.
  // `bits` is also what GL_REPLACE writes.
  void stencil_test(unsigned bits, unsigned compared);

  // For a pass that marks pixels by itself: from here on all bits of the stencil are 0, and its own
  // to write; the next begin_plane() makes them so again.
  void begin_marks();

  // Passes on the plane's own pixels, with whatever shadow bits; without a stencil where all of the
  // picture is the plane's.
  void test_place();

  // The grid of receiver.vert.glsl, for programs that begin with it and are in use. Sets their lens
  // and place, and draws.
  void draw_grid(const ShaderProgram& program, const FramePlan& plan, const PlaneFrame& frame,
                 const LensUniforms& lens) const;
  // The plane's depth, with the tests and masks as they are: the same as begin_frame() gave it.
  void draw_place(const FramePlan& plan, const PlaneFrame& frame, const LensUniforms& lens) const;

 private:
  struct Outline {
    VertexArray layout;
    GlBuffer vertices{BufferUse::vertices};
    int count = 0;  // 0: the plane is unbounded
  };
  Receivers(ShaderProgram outline, ShaderProgram plane)
      : outline_program_(std::move(outline)), plane_program_(std::move(plane)) {}

  void turn_outline_over(const Outline& outline, const FramePlan& plan, const PlaneFrame& frame,
                         const LensUniforms& lens) const;

  ShaderProgram outline_program_;
  ShaderProgram plane_program_;
  std::vector<Outline> outlines_;  // one per scene plane
  VertexArray grid_layout_;
  GlBuffer grid_vertices_{BufferUse::vertices};
  GlBuffer grid_indices_{BufferUse::indices};
  int grid_index_count_ = 0;
  glm::vec4 view_rect_{0.0F};
  bool depth_drawn_ = false;  // in this frame
  bool marked_ = false;       // the current plane's pixels, in kReceiverBit
  bool used_ = false;         // the stencil is not all 0
};

}  // namespace penumbra
