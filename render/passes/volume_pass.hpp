// Shadow volumes (Hudson's shadow of a 3D cursor) on everything that is in the depth buffer:
// planes, phantoms and virtual objects. z-fail counting: right wherever the eye is, and whatever
// the near plane cuts.
#pragma once

#include <glm/vec3.hpp>
#include <map>
#include <memory>
#include <optional>
#include <tuple>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/passes/object_pass.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/shadow_pass.hpp"
#include "render/scene.hpp"
#include "render/shadow/shadow_volume.hpp"

namespace penumbra {

class VolumePass {
 public:
  [[nodiscard]] static Result<VolumePass> create(GlApi api, const CameraModel& camera);

  // The CPU's part: volumes of casters that moved, or whose light did. Adds to `work`.
  void prepare(const Scene& scene, const FramePlan& plan, ShadowWork& work);
  // The plan must be the one prepared; depth: phantoms, objects and planes. The shadow is as strong
  // as the fainter of what casts it and what it falls on. Number of draw calls.
  int draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
           const ObjectPass& objects, const Receivers& receivers) const;

 private:
  struct Volume {
    bool valid = false;
    Placement T_table_object;
    Eigen::Vector4d light;
    std::vector<PlaneFrame> floors;
    int count = 0;
    bool layout_made = false;
    VertexArray layout;
    GlBuffer vertices{BufferUse::vertices};
  };
  using Key = std::tuple<int, int>;  // object, light

  VolumePass(ShaderProgram volume, ShaderProgram fill)
      : volume_program_(std::move(volume)), fill_program_(std::move(fill)) {}

  // Leaves how often each pixel's ray is in the volume, in the stencil's bits for that.
  int count(const Scene& scene, const FramePlan& plan, const ShadowVolumeDraw& draw,
            const LensUniforms& lens, const ObjectPass& objects) const;
  void note_dark() const;
  void darken(const FramePlan& plan, float opacity) const;
  int draw_faint(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                 const ObjectPass& objects, const Receivers& receivers) const;

  ShaderProgram volume_program_;
  ShaderProgram fill_program_;
  std::optional<double> longest_edge_;  // [m]; none: the lens keeps straight edges straight
  VertexArray no_vertices_;
  std::map<const Model*, std::unique_ptr<VolumeCaster>> casters_;
  std::map<Key, Volume> volumes_;
};

}  // namespace penumbra
