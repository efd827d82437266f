#include "render/passes/receivers.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>
#include <glm/vec2.hpp>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

// Cells of up to 16 px at 640 x 480, whose edges the lens bends by less than 0.05 px.
constexpr int kColumns = 40;
constexpr int kRows = 30;

}  // namespace

Result<TranslucentProgram> plane_light_program(GlApi api) {
  return TranslucentProgram::create(api, {"lens.glsl", "receiver.vert.glsl"},
                                    {"ambient.glsl", "light_share.glsl", "blocked_light.frag.glsl"},
                                    {kLightDefine});
}

void begin_plane_light(const ShaderProgram& program, const FramePlan& plan, const PlaneFrame& plane,
                       float opacity) {
  program.use();
  program.set("table_from_camera", to_gl(plan.T_table_camera.rotation().toRotationMatrix()));
  program.set("normal", to_gl(plane.n));
  program.set("opacity", opacity);
}

void end_planes() {
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  end_translucent();
  glDepthMask(GL_TRUE);
}

Result<Receivers> Receivers::create(GlApi api, const Scene& scene, const CameraModel& camera) {
  Receivers receivers;
  PENUMBRA_TRY(receivers.outline_program_,
               ShaderProgram::link(api, {"lens.glsl", "outline.vert.glsl"}, {"fill.frag.glsl"}));
  PENUMBRA_TRY(receivers.plane_program_,
               ShaderProgram::link(api, {"lens.glsl", "receiver.vert.glsl"}, {"fill.frag.glsl"}));
  const double longest = longest_edge(camera);
  for (const ScenePlane& receiver : scene.planes) {
    std::vector<glm::vec2> points;
    for (std::size_t i = 0; i < receiver.outline.size(); ++i) {
      const Eigen::Vector2d& a = receiver.outline[i];
      const Eigen::Vector2d& b = receiver.outline[(i + 1) % receiver.outline.size()];
      const int pieces = std::clamp(static_cast<int>(std::ceil((b - a).norm() / longest)), 1, 1000);
      for (int j = 0; j < pieces; ++j) {
        const Eigen::Vector2d p = a + (b - a) * (static_cast<double>(j) / pieces);
        points.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
      }
    }
    receivers.outlines_.push_back(GlMesh{2});
    if (!points.empty()) receivers.outlines_.back().write(points);
  }

  const ViewFrustum view = make_frustum(camera);
  receivers.view_rect_ = {static_cast<float>(view.x_min), static_cast<float>(view.y_min),
                          static_cast<float>(view.x_max - view.x_min),
                          static_cast<float>(view.y_max - view.y_min)};
  std::vector<glm::vec2> corners;
  for (int y = 0; y <= kRows; ++y) {
    for (int x = 0; x <= kColumns; ++x) {
      corners.emplace_back(static_cast<float>(x) / kColumns, static_cast<float>(y) / kRows);
    }
  }
  std::vector<std::uint32_t> indices;
  for (std::uint32_t y = 0; y < kRows; ++y) {
    for (std::uint32_t x = 0; x < kColumns; ++x) {
      const std::uint32_t a = y * (kColumns + 1) + x;
      const std::uint32_t c = a + kColumns + 1;
      for (const std::uint32_t i : {a, a + 1, c + 1, a, c + 1, c}) indices.push_back(i);
    }
  }
  receivers.grid_.write(corners);
  receivers.grid_.write_indices(indices);
  return receivers;
}

void Receivers::invert_outline(const GlMesh& outline, const FramePlan& plan,
                               const PlaneFrame& frame, const LensUniforms& lens) const {
  // A triangle fan that inverts the bit leaves it set inside any simple polygon.
  outline_program_.use();
  set_lens(outline_program_, lens);
  outline_program_.set("camera_from_plane", camera_from_plane(plan.T_table_camera, frame));
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_BLEND);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glStencilMask(kReceiverBit);
  glStencilFunc(GL_ALWAYS, 0, 0xFF);
  glStencilOp(GL_KEEP, GL_KEEP, GL_INVERT);
  outline.draw(GL_TRIANGLE_FAN);
}

void Receivers::draw_grid(const ShaderProgram& program, const FramePlan& plan,
                          const PlaneFrame& frame, const LensUniforms& lens) const {
  set_lens(program, lens);
  program.set("view_rect", view_rect_);
  program.set("inverse_depth", inverse_depth(plan.T_table_camera, frame));
  grid_.draw(GL_TRIANGLES);
}

void Receivers::draw_depth(const FramePlan& plan, const PlaneFrame& frame,
                           const LensUniforms& lens) const {
  plane_program_.use();
  draw_grid(plane_program_, plan, frame, lens);
}

int Receivers::begin_frame(const FramePlan& plan, const LensUniforms& lens, bool depth) {
  used_ = false;
  marked_ = false;
  depth_drawn_ = depth || plan.receivers.size() > 1;
  if (!depth_drawn_) return 0;
  glEnable(GL_STENCIL_TEST);
  for (const PlaneReceiver& receiver : plan.receivers) {
    const GlMesh& outline = outlines_[static_cast<std::size_t>(receiver.plane)];
    if (outline.count() > 0) invert_outline(outline, plan, receiver.frame, lens);
    plane_program_.use();
    glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
    glDisable(GL_BLEND);
    glEnable(GL_DEPTH_TEST);
    glDepthFunc(GL_LESS);
    glDepthMask(GL_TRUE);
    glStencilMask(0);
    glStencilFunc(outline.count() > 0 ? GL_EQUAL : GL_ALWAYS, static_cast<GLint>(kReceiverBit),
                  kReceiverBit);
    draw_grid(plane_program_, plan, receiver.frame, lens);
    if (outline.count() > 0) invert_outline(outline, plan, receiver.frame, lens);
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  return static_cast<int>(plan.receivers.size());
}

void Receivers::begin_plane(const FramePlan& plan, int plane, const PlaneFrame& frame,
                            const LensUniforms& lens) {
  glEnable(GL_STENCIL_TEST);
  glStencilMask(0xFF);
  if (used_) glClear(GL_STENCIL_BUFFER_BIT);
  const GlMesh& outline = outlines_[static_cast<std::size_t>(plane)];
  if (outline.count() > 0) invert_outline(outline, plan, frame, lens);
  marked_ = outline.count() > 0 || depth_drawn_;
  used_ = marked_;
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  if (depth_drawn_) {
    // Marks the pixels with the plane's depth inside its outline.
    plane_program_.use();
    glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
    glDisable(GL_BLEND);
    glDepthFunc(GL_EQUAL);
    glDepthMask(GL_FALSE);
    glStencilMask(kReceiverBit);
    if (outline.count() > 0) {
      glStencilFunc(GL_EQUAL, static_cast<GLint>(kReceiverBit), kReceiverBit);
      glStencilOp(GL_KEEP, GL_ZERO, GL_KEEP);
    } else {
      glStencilFunc(GL_ALWAYS, static_cast<GLint>(kReceiverBit), kReceiverBit);
      glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
    }
    draw_grid(plane_program_, plan, frame, lens);
    glDisable(GL_DEPTH_TEST);
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDepthMask(GL_FALSE);
  glStencilMask(kShadowBits);
}

void Receivers::clear_stencil() {
  glStencilMask(0xFF);
  if (used_) glClear(GL_STENCIL_BUFFER_BIT);
  used_ = true;
}

void Receivers::test_plane() {
  if (marked_) {
    stencil_test(0, 0);
  } else {
    glDisable(GL_STENCIL_TEST);
  }
}

void Receivers::stencil_test(unsigned bits, unsigned compared) {
  used_ = true;
  PENUMBRA_ASSERT((bits & ~kShadowBits) == 0 && (compared & ~kShadowBits) == 0);
  const unsigned mark = marked_ ? kReceiverBit : 0U;
  glStencilFunc(GL_EQUAL, static_cast<GLint>(mark | bits), mark | compared);
}

}  // namespace penumbra
