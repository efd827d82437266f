// Layered and simple shadows on phantoms and on other virtual objects by nested volumes
// (rendering.md 5), instead of pictures at heights (received_shadow_pass.hpp): of each layer the
// imaginary mesh swept straight down. Counted z-fail, so right wherever the eye is; then what
// receives is drawn again where it lies in the volume, and darkened: once, by the darkest layer,
// its sides as its top. A box in a shadow carries the outlines that the table would.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <tuple>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/shader.hpp"
#include "render/passes/object_pass.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/shadow_pass.hpp"
#include "render/passes/volume_buffers.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/layers/layer_volume.hpp"

namespace penumbra {

class LayerVolumePass {
 public:
  LayerVolumePass(GlApi api, const CameraModel& camera);

  // Links what a plan with volumes is drawn with, when the first comes.
  [[nodiscard]] Result<void> choose(const FramePlan& plan);
  // The CPU's part: volumes of casters that moved. Nothing unless the plan climbs by volumes. Adds
  // to `work`.
  void prepare(const Scene& scene, const FramePlan& plan, ShadowPass& shadows, ShadowWork& work);
  // The plan must be the one prepared; with the depth of phantoms, objects and planes, and
  // `objects` drawing in the same way. Number of draw calls.
  int draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
           const ObjectPass& objects, Translucency way, Receivers& receivers,
           Framebuffer& framebuffer) const;

 private:
  // Of one caster's shadow on the way to a plane.
  struct Volumes {
    bool valid = false;
    ShadowDraw shadow;
    std::array<std::unique_ptr<VolumeBuffers>, 3> layers;  // null: not wanted
    std::uint64_t last_used = 0;
  };
  using Key = std::tuple<int, int, int>;  // node, object, plane
  static Key key_of(const ShadowDraw& draw) { return {draw.node, draw.object, draw.plane}; }

  GlApi api_;
  std::optional<double> longest_edge_;  // [m]; none: the lens keeps straight edges straight
  std::optional<ShaderProgram> program_;
  std::map<const ShadowMesh*, std::unique_ptr<LayerVolumeCaster>> casters_;
  std::map<Key, Volumes> volumes_;
  std::uint64_t frame_count_ = 0;
};

}  // namespace penumbra
