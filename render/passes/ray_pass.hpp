// Light rays through vertices of casters, with dots at the vertices, at their shadows and at the
// light: drawn last, in front of or behind what the depth buffer says.
#pragma once

#include <cstddef>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <map>
#include <memory>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/projected/light_rays.hpp"

namespace penumbra {

class RayPass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<RayPass>> create(GlApi api,
                                                               const CameraModel& camera);

  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  // A corner of a ribbon or a dot; both face the camera.
  struct Corner {
    glm::vec3 place;   // table frame [m]
    glm::vec3 along;   // a ribbon's direction; zero: a dot
    glm::vec2 corner;  // -1 or 1; of a ribbon x alone, across it
    glm::vec3 color;   // sRGB-encoded
  };
  struct Batch {
    float opacity = 1.0F;
    std::size_t first = 0, count = 0;
  };
  explicit RayPass(TranslucentProgram program) : program_(std::move(program)) {}

  void add_ribbon(const Eigen::Vector3d& from, const Eigen::Vector3d& to, const glm::vec3& color);
  void add_dot(const Eigen::Vector3d& at, const glm::vec3& color);

  TranslucentProgram program_;
  glm::vec2 half_width_{0.0F};  // of a ribbon and of a dot, over the depth
  int pieces_ = 1;              // of a ray, to follow the lens
  std::map<const Model*, std::vector<MarkedVertex>> marked_;
  std::vector<Corner> corners_;
  VertexArray layout_;
  GlBuffer vertices_{BufferUse::vertices};
  bool layout_made_ = false;
};

}  // namespace penumbra
