#include "render/passes/ray_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxVertices = 12;  // maximum number of marked vertices per caster
constexpr int kPieces = 48;               // pieces of a ray, which follow the lens distortion
// Half widths, as fractions of the image's height.
constexpr double kRayPerHeight = 0.0016;
constexpr double kDotPerHeight = 0.0075;
constexpr double kMinRay_px = 0.6;
constexpr double kMinDot_px = 2.2;

glm::vec3 encoded(const glm::vec3& linear) {
  const auto encode = [](float v) { return std::pow(std::clamp(v, 0.0F, 1.0F), 1.0F / 2.2F); };
  return {encode(linear.r), encode(linear.g), encode(linear.b)};
}

}  // namespace

Result<std::unique_ptr<RayPass>> RayPass::create(GlApi api, const CameraModel& camera) {
  auto pass = std::make_unique<RayPass>();
  PENUMBRA_TRY(pass->program_,
               TranslucentProgram::create(api, {"lens.glsl", "ray.vert.glsl"}, {"ray.frag.glsl"}));
  const CameraParameters& p = camera.parameters();
  pass->half_width_ = {static_cast<float>(std::max(kMinRay_px, kRayPerHeight * p.height) / p.fy),
                       static_cast<float>(std::max(kMinDot_px, kDotPerHeight * p.height) / p.fy)};
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
  for (const glm::vec2& corner : {glm::vec2(-1, -1), glm::vec2(1, -1), glm::vec2(1), glm::vec2(-1),
                                  glm::vec2(1), glm::vec2(-1, 1)}) {
    corners_.push_back({to_gl(at), glm::vec3(0.0F), corner, color});
  }
}

int RayPass::draw(const DrawContext& context, const FramePlan& plan) {
  if (plan.rays.empty()) return 0;
  const Scene& scene = context.scene;
  corners_.clear();
  std::vector<Batch> batches;
  std::set<int> lights;
  for (const LightRayDraw& draw : plan.rays) {
    const std::vector<MarkedVertex>& marked =
        marked_.of(scene, draw.object, draw.proxy,
                   [](const Model& model) { return marked_vertices(model, kMaxVertices); });
    std::vector<RayReceiver> planes;
    for (const LightRayDraw::Plane& plane : draw.planes) {
      planes.push_back({plane.frame, scene.planes[static_cast<std::size_t>(plane.index)].outline});
    }
    if (batches.empty() || batches.back().opacity != draw.opacity) {
      batches.push_back({draw.opacity, static_cast<int>(corners_.size()), 0});
    }
    for (const LightRay& ray :
         light_rays(marked, draw.T_table_object, draw.light_position, planes)) {
      const glm::vec3 color = encoded(ray.color);
      add_ribbon(ray.from, ray.shadow, color);
      add_dot(ray.vertex, color);
      add_dot(ray.shadow, color);
    }
    if (draw.light_position.w() != 0.0 && lights.insert(draw.light).second) {
      add_dot(draw.light_position.head<3>() / draw.light_position.w(), glm::vec3(1.0F));
    }
    batches.back().count = static_cast<int>(corners_.size()) - batches.back().first;
  }

  triangles_.write(corners_, BufferLife::every_frame);
  const auto begin = [&](const ShaderProgram& program) {
    program.use();
    set_lens(program, context.lens);
    program.set("camera_from_table", camera_from_object(plan.T_table_camera, Placement()));
    program.set("half_width", half_width_);
  };
  begin(program_.plain());
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDisable(GL_STENCIL_TEST);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);  // the nearer of two crossing rays is visible
  const auto faint = [](const Batch& batch) { return batch.opacity < 1.0F; };
  if (std::ranges::none_of(batches, faint)) {
    glDisable(GL_BLEND);
    triangles_.draw(GL_TRIANGLES);
    return 1;
  }
  // Draws depth first, then colour at equal depth, so that overlapping rays are blended once.
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  triangles_.draw(GL_TRIANGLES);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDepthFunc(GL_EQUAL);
  glDepthMask(GL_FALSE);
  if (context.mode == Translucency::retexture) context.framebuffer.copy_image(kFramebufferCopyUnit);
  // Dots of several lights at one vertex have equal depth; the stencil keeps the first.
  glStencilMask(0xFF);
  glClear(GL_STENCIL_BUFFER_BIT);
  glEnable(GL_STENCIL_TEST);
  glStencilFunc(GL_EQUAL, 0, 0xFF);
  glStencilOp(GL_KEEP, GL_KEEP, GL_INCR);
  begin(program_.get());
  begin_translucent(context.mode, Blending::mix);
  int calls = 1;
  for (const Batch& batch : batches) {
    if (batch.count == 0) continue;
    set_mixing(context.mode, program_.get(), batch.opacity);
    triangles_.draw(GL_TRIANGLES, batch.first, batch.count);
    ++calls;
  }
  end_translucent();
  glDisable(GL_STENCIL_TEST);
  glDepthMask(GL_TRUE);
  glDepthFunc(GL_LESS);
  return calls;
}

}  // namespace penumbra
