// Draws light rays through vertices of casters, with dots at the vertices, their shadows and the
// light. Drawn last, with depth test.
#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <map>
#include <memory>
#include <vector>

#include "render/gl/buffer.hpp"
#include "render/passes/casting_models.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/translucent_program.hpp"
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
    glm::vec2 corner;  // -1 or 1; x across a ribbon
    glm::vec3 color;   // sRGB-encoded
  };
  struct Batch {
    float opacity = 1.0F;
    int first = 0, count = 0;  // vertices
  };

  void add_ribbon(const Eigen::Vector3d& from, const Eigen::Vector3d& to, const glm::vec3& color);
  void add_dot(const Eigen::Vector3d& at, const glm::vec3& color);

  TranslucentProgram program_;
  glm::vec2 half_width_{0.0F};  // half widths of ribbon and dot, divided by the depth
  int pieces_ = 1;              // pieces per ray, which follow the lens distortion
  CastingModels<std::vector<MarkedVertex>> marked_;
  std::vector<Corner> corners_;
  GlMesh triangles_{3, 3, 2, 3};
};

}  // namespace penumbra
