#include "render/passes/ray_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <span>
#include <string_view>
#include <utility>

#include "core/propagate.hpp"
#include "render/passes/lens_uniforms.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMostVertices = 12;  // of a caster
constexpr int kPieces = 48;                // a ray across the whole view, bent by a lens
// Half widths: a ray is thin beside what it explains, a dot still found in a small picture.
constexpr double kRayPerHeight = 0.0016;
constexpr double kDotPerHeight = 0.0075;
constexpr double kLeastRay_px = 0.6;
constexpr double kLeastDot_px = 2.2;

glm::vec3 encoded(const glm::vec3& linear) {
  return {std::pow(std::clamp(linear.r, 0.0F, 1.0F), 1.0F / 2.2F),
          std::pow(std::clamp(linear.g, 0.0F, 1.0F), 1.0F / 2.2F),
          std::pow(std::clamp(linear.b, 0.0F, 1.0F), 1.0F / 2.2F)};
}

}  // namespace

Result<std::unique_ptr<RayPass>> RayPass::create(GlApi api, const CameraModel& camera) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "ray.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFragment = {"ray.frag.glsl"};
  PENUMBRA_TRY(auto program, TranslucentProgram::create(api, kVertex, kFragment));
  std::unique_ptr<RayPass> pass(new RayPass(std::move(program)));
  const CameraParameters& p = camera.parameters();
  pass->half_width_ = {static_cast<float>(std::max(kLeastRay_px, kRayPerHeight * p.height) / p.fy),
                       static_cast<float>(std::max(kLeastDot_px, kDotPerHeight * p.height) / p.fy)};
  if (camera.has_distortion()) pass->pieces_ = kPieces;
  return pass;
}

Result<void> RayPass::prepare(const DrawContext& context, const FramePlan& /*plan*/) {
  return program_.choose(context.mode, context.video_format);
}

void RayPass::add_ribbon(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                         const glm::vec3& color) {
  const glm::vec3 along = to_gl(Eigen::Vector3d(to - from));
  const auto at = [&](int piece, float side) {
    const double t = static_cast<double>(piece) / pieces_;
    return Corner{to_gl(Eigen::Vector3d(from + t * (to - from))), along, {side, 0.0F}, color};
  };
  for (int piece = 0; piece < pieces_; ++piece) {
    for (const auto& [end, side] :
         {std::pair{0, -1.0F}, {1, -1.0F}, {1, 1.0F}, {0, -1.0F}, {1, 1.0F}, {0, 1.0F}}) {
      corners_.push_back(at(piece + end, side));
    }
  }
}

void RayPass::add_dot(const Eigen::Vector3d& at, const glm::vec3& color) {
  for (const auto& [x, y] : {std::pair{-1.0F, -1.0F},
                             {1.0F, -1.0F},
                             {1.0F, 1.0F},
                             {-1.0F, -1.0F},
                             {1.0F, 1.0F},
                             {-1.0F, 1.0F}}) {
    corners_.push_back({to_gl(at), glm::vec3(0.0F), {x, y}, color});
  }
}

int RayPass::draw(const DrawContext& context, const FramePlan& plan) {
  if (plan.rays.empty()) return 0;
  const Scene& scene = context.scene;
  corners_.clear();
  std::vector<Batch> batches;
  std::set<int> lights;
  for (const LightRayDraw& draw : plan.rays) {
    const Model* model =
        casting_model(scene.objects[static_cast<std::size_t>(draw.object)], draw.proxy).get();
    auto marked = marked_.find(model);
    if (marked == marked_.end()) {
      marked = marked_.emplace(model, marked_vertices(*model, kMostVertices)).first;
    }
    std::vector<RayReceiver> planes;
    for (const LightRayDraw::Plane& plane : draw.planes) {
      planes.push_back({plane.frame, scene.planes[static_cast<std::size_t>(plane.index)].outline});
    }
    if (batches.empty() || batches.back().opacity != draw.opacity) {
      batches.push_back({draw.opacity, corners_.size(), 0});
    }
    for (const LightRay& ray :
         light_rays(marked->second, draw.T_table_object, draw.light_place, planes)) {
      const glm::vec3 color = encoded(ray.color);
      add_ribbon(ray.from, ray.shadow, color);
      add_dot(ray.vertex, color);
      add_dot(ray.shadow, color);
    }
    if (draw.light_place.w() != 0.0 && lights.insert(draw.light).second) {
      add_dot(draw.light_place.head<3>() / draw.light_place.w(), glm::vec3(1.0F));
    }
    batches.back().count = corners_.size() - batches.back().first;
  }

  layout_.bind();
  vertices_.write(std::span<const Corner>(corners_), BufferLife::every_frame);
  if (!layout_made_) {
    VertexArray::attribute(0, 3, sizeof(Corner), offsetof(Corner, place));
    VertexArray::attribute(1, 3, sizeof(Corner), offsetof(Corner, along));
    VertexArray::attribute(2, 2, sizeof(Corner), offsetof(Corner, corner));
    VertexArray::attribute(3, 3, sizeof(Corner), offsetof(Corner, color));
    layout_made_ = true;
  }
  const auto begin = [&](const ShaderProgram& program) {
    program.use();
    set_lens(program, context.lens);
    program.set("camera_from_table", camera_from_object(plan.T_table_camera, Placement()));
    program.set("half_width", half_width_);
    program.set("picture_before", kPictureBeforeUnit);
  };
  begin(program_.plain());
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDisable(GL_STENCIL_TEST);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);  // of two rays that cross the nearer one is seen
  const auto faint = [](const Batch& batch) { return batch.opacity < 1.0F; };
  if (std::ranges::none_of(batches, faint)) {
    glDisable(GL_BLEND);
    glDrawArrays(GL_TRIANGLES, 0, static_cast<GLsizei>(corners_.size()));
    return 1;
  }
  // Depth first, then colour where the depth is equal: what overlaps is mixed into the video once.
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDrawArrays(GL_TRIANGLES, 0, static_cast<GLsizei>(corners_.size()));
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDepthFunc(GL_EQUAL);
  glDepthMask(GL_FALSE);
  if (context.mode == Translucency::retexture) context.framebuffer.copy_picture(kPictureBeforeUnit);
  // Dots of several lights at one vertex have one depth: a pixel is of the first.
  glStencilMask(0xFF);
  glClear(GL_STENCIL_BUFFER_BIT);
  glEnable(GL_STENCIL_TEST);
  glStencilFunc(GL_EQUAL, 0, 0xFF);
  glStencilOp(GL_KEEP, GL_KEEP, GL_INCR);
  begin(program_.get());
  begin_mixing(context.mode);
  int calls = 1;
  for (const Batch& batch : batches) {
    if (batch.count == 0) continue;
    set_mixing(context.mode, program_.get(), batch.opacity);
    glDrawArrays(GL_TRIANGLES, static_cast<GLint>(batch.first), static_cast<GLsizei>(batch.count));
    ++calls;
  }
  end_translucent();
  glDisable(GL_STENCIL_TEST);
  glDepthMask(GL_TRUE);
  glDepthFunc(GL_LESS);
  return calls;
}

}  // namespace penumbra
