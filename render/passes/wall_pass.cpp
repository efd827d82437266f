#include "render/passes/wall_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>

#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

constexpr double kLinePerHeight = 0.0025;  // width of a line / height of the image
constexpr double kMinLine_px = 1.2;
constexpr double kMinCells = 10.0;  // along the longer side; at most 2.5 times as many

// Returns the largest of 1, 2 and 5 times a power of ten that divides a side into kMinCells or
// more.
float grid_spacing(double side) {
  const double most = side / kMinCells * (1.0 + 1e-9);
  const double decade = std::pow(10.0, std::floor(std::log10(most)));
  for (const double step : {5.0, 2.0}) {
    if (step * decade <= most) return static_cast<float>(step * decade);
  }
  return static_cast<float>(decade);
}

}  // namespace

Result<std::unique_ptr<WallPass>> WallPass::create(GlApi api, const CameraModel& camera) {
  auto pass = std::make_unique<WallPass>();
  PENUMBRA_TRY(pass->program_, TranslucentProgram::create(api, {"lens.glsl", "receiver.vert.glsl"},
                                                          {"wall.frag.glsl"}));
  pass->line_width_ = static_cast<float>(std::max(kMinLine_px, kLinePerHeight * camera.height()));
  return pass;
}

Result<void> WallPass::prepare(const DrawContext& context, const FramePlan& plan) {
  if (std::ranges::none_of(plan.receivers, &PlaneReceiver::virtual_wall)) return {};
  return program_.choose(context.mode, context.video_format);
}

void WallPass::draw_wall(const DrawContext& context, const FramePlan& plan,
                         const PlaneReceiver& wall) const {
  Eigen::AlignedBox2d bounds;
  for (const Eigen::Vector2d& p :
       context.scene.planes[static_cast<std::size_t>(wall.plane)].outline)
    bounds.extend(p);
  context.receivers.begin_plane(plan, wall.plane, wall.frame, context.lens);
  context.receivers.test_plane();
  glStencilOp(GL_KEEP, GL_KEEP, GL_KEEP);
  begin_translucent(context.mode, Blending::see_through);
  const ShaderProgram& program = program_.get();
  program.use();
  Eigen::Matrix3d plane_from_table;
  plane_from_table << wall.frame.e1.transpose(), wall.frame.e2.transpose(),
      wall.frame.n.transpose();
  program.set("plane_from_camera",
              to_gl(Eigen::Matrix3d(plane_from_table * plan.T_table_camera.rotation())));
  program.set("eye", to_gl(wall.frame.to_plane(plan.T_table_camera.translation())));
  program.set(
      "wall_bounds",
      glm::vec4(static_cast<float>(bounds.min().x()), static_cast<float>(bounds.min().y()),
                static_cast<float>(bounds.max().x()), static_cast<float>(bounds.max().y())));
  program.set("spacing", grid_spacing(bounds.sizes().maxCoeff()));
  program.set("line_width", line_width_);
  program.set("opacity", wall.opacity);
  context.receivers.draw_grid(program, plan, wall.frame, context.lens);
}

int WallPass::draw(const DrawContext& context, const FramePlan& plan) {
  int calls = 0;
  for (const PlaneReceiver& receiver : plan.receivers) {
    if (!receiver.virtual_wall) continue;
    // One copy is enough, because a pixel shows no more than one plane.
    if (calls == 0 && context.mode == Translucency::retexture)
      context.framebuffer.copy_image(kFramebufferCopyUnit);
    draw_wall(context, plan, receiver);
    ++calls;
  }
  if (calls == 0) return 0;
  end_planes();
  return calls;
}

}  // namespace penumbra
