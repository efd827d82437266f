// Layered, field and simple shadows on phantoms and on other virtual objects. Each shadow that such
// a receiver may meet on its way to a plane is made as seen along the plane's normal, for each of
// the receiver's levels as on a plane at that height: covered as masks of planes are, or drawn with
// several samples a texel. Then the receiver's pixels are darkened by what lies over each of them,
// once, by the caster that leaves least, as a plane's are (through a screen-door, shadows onto
// planes that face elsewhere are not darker where they meet). A face gets as much of the light as
// Lambert's law lets it.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <tuple>
#include <utility>
#include <vector>

#include "render/frame_plan.hpp"
#include "render/gl/mask_stack.hpp"
#include "render/passes/object_pass.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/shadow_pass.hpp"
#include "render/shadow/layers/receiving_levels.hpp"

namespace penumbra {

class ReceivedShadowPass {
 public:
  // Draws the shadows of what changed, into framebuffers of its own. The shadows of the plan must
  // have been prepared. Adds to `work`. Number of draw calls.
  int prepare(const Scene& scene, const FramePlan& plan, ShadowPass& shadows, ShadowWork& work);
  // The plan must be the one prepared; with the depth of phantoms, objects and planes, and
  // `objects` drawing in the same way. Number of draw calls.
  int draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
           const ObjectPass& objects, Translucency way, Receivers& receivers,
           Framebuffer& framebuffer) const;

 private:
  // Of a receiver over a plane.
  struct Surface {
    Placement T_table_object;
    PlaneFrame plane;
    ReceivingSurface faces;
    std::uint64_t version = 0;  // no two are alike; 0: not made
    std::uint64_t last_used = 0;
  };
  // Of one caster's shadow on the way to a plane, over one receiver.
  struct Mask {
    bool valid = false;
    ShadowDraw shadow;
    std::uint64_t surface = 0;  // its version
    double top = 0.0;
    double texel = 0.0;  // as the view asks for [m]
    double most_texels = 0.0;
    std::vector<double> levels;
    bool covered = false;            // made by covers_flat()
    bool shows = false;              // something is in some picture
    Eigen::Vector2d origin, extent;  // what the pictures show of the plane [m]
    MaskStack pictures;
  };
  // The last two: a camera at rest may tremble between two sizes of texels.
  struct Masks {
    Mask now, other;
    std::uint64_t last_used = 0;
  };
  struct Shown {
    const Mask* mask = nullptr;
    const ReceivedShadowDraw* draw = nullptr;
    ObjectDraw receiver;
  };

  const Surface& surface_of(const Scene& scene, const ObjectDraw& receiver, int plane,
                            const PlaneFrame& frame);
  int make_mask(const Scene& scene, const ReceivedShadowDraw& draw, const Surface& surface,
                Mask& mask, ShadowPass& shadows, ShadowWork& work);
  // Makes the pictures of its levels without drawing ...
  void cover_levels(const Scene& scene, const ReceivedShadowDraw& draw, const Surface& surface,
                    const MaskCells& cells, Mask& mask, ShadowPass& shadows, ShadowWork& work);
  // ... or draws them. Number of draw calls.
  static int draw_levels(const Scene& scene, const ReceivedShadowDraw& draw, const Surface& surface,
                         Mask& mask, ShadowPass& shadows, ShadowWork& work);
  static int draw_shadow(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                         const ObjectPass& objects, const Shown& shown, Gathering gathering);

  std::map<std::pair<int, int>, Surface> surfaces_;        // receiver, plane
  std::map<std::tuple<int, int, int, int>, Masks> masks_;  // node, object, plane, receiver
  std::vector<Shown> shown_;                               // in this frame
  std::vector<std::uint8_t> shares_;
  std::uint64_t frame_count_ = 0;
  std::uint64_t surfaces_made_ = 0;
};

}  // namespace penumbra
