// Layered, field and simple shadows on phantoms. For each phantom that a plane's shadows meet on
// their way, they are drawn as seen along the plane's normal, for each of the phantom's levels as
// on a plane at that height; then the phantom is darkened by what lies over each of its pixels,
// between two levels by both. A face gets as much of the light as Lambert's law lets it.
#pragma once

#include <glm/mat4x3.hpp>
#include <glm/vec2.hpp>
#include <map>
#include <utility>
#include <vector>

#include "render/frame_plan.hpp"
#include "render/gl/mask_stack.hpp"
#include "render/passes/object_pass.hpp"
#include "render/passes/shadow_pass.hpp"

namespace penumbra {

class PhantomShadowPass {
 public:
  // Draws the shadows of what changed, into framebuffers of its own. The shadows of the plan must
  // have been prepared. Adds to `work`. Number of draw calls.
  int prepare(const Scene& scene, const FramePlan& plan, ShadowPass& shadows, ShadowWork& work);
  // The plan must be the one prepared; with the depth of phantoms, objects and planes. Number of
  // draw calls.
  int draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
           const ObjectPass& objects) const;

 private:
  struct Mask {
    bool valid = false;
    std::vector<ShadowDraw> shadows;
    ObjectDraw phantom;
    PlaneFrame plane;
    std::vector<double> levels;
    Eigen::Vector2d origin, extent;  // what the picture shows of the plane [m]
    MaskStack pictures;
  };
  using Key = std::pair<int, int>;  // phantom, plane

  static int draw_mask(const Scene& scene, const std::vector<const PhantomShadowDraw*>& draws,
                       Mask& mask, ShadowPass& shadows, ShadowWork& work);

  std::map<Key, Mask> masks_;
  std::vector<Key> shown_;  // in this frame, by plane as the plan has them
};

}  // namespace penumbra
