// Layered, field and simple shadows on phantoms and on other virtual objects
// (docs/rendering.md#shadows-on-receivers). Each shadow that such a receiver may meet on its way to
// a plane is made as seen along the plane's normal, at each of the receiver's levels as on a plane
// at that height: covered as masks of planes are, or drawn with several samples a texel. Then the
// receiver's pixels are darkened by what lies over each of them, once, by the caster that leaves
// least (through a screen-door, shadows onto planes that face elsewhere are not darker where they
// meet). A face gets as much of the light as Lambert's law lets it.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <tuple>
#include <utility>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "render/gl/mask_stack.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/layer_painter.hpp"
#include "render/passes/mask_part.hpp"
#include "render/passes/shadow_geometry.hpp"
#include "render/shadow/layers/receiving_levels.hpp"

namespace penumbra {

class ReceivedShadowPass : public Pass {
 public:
  // `geometry` and `painter` outlive the pass. `multisampled`: pixels of the framebuffer have
  // several samples.
  ReceivedShadowPass(const CameraModel& camera, const ShadowGeometry& geometry,
                     LayerPainter& painter, bool multisampled);

  // Draws the masks of what changed, into framebuffers of their own.
  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  // A receiver over a plane.
  struct Surface {
    Placement T_table_object;
    PlaneFrame plane;
    ReceivingSurface faces;
    std::uint64_t version = 0;  // unique; 0: not made
    std::uint64_t last_used = 0;
  };
  // One caster's shadow on the way to a plane, over one receiver.
  struct Mask {
    bool valid = false;
    ShadowDraw shadow;
    std::uint64_t surface = 0;  // its version
    double top = 0.0;
    double texel = 0.0;  // as the view asks for [m]
    double most_texels = 0.0;
    std::vector<double> levels;
    bool covered = false;            // made without drawing
    bool shows = false;              // some level is not empty
    Eigen::Vector2d origin, extent;  // of the mask on the plane [m]
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
  // A shadow on one level of a receiver.
  struct Level {
    ShadowDraw shadow;
    ShadowItem item;
  };

  const Surface& surface_of(const Scene& scene, const ObjectDraw& receiver, int plane,
                            const PlaneFrame& frame);
  // Whether a shadow's levels are covered as masks of planes are, not drawn.
  [[nodiscard]] bool is_covered(const Scene& scene, const FramePlan& plan,
                                const ShadowDraw& draw) const;
  [[nodiscard]] Level prepare_level(const Scene& scene, const ReceivedShadowDraw& draw, int level,
                                    const PlaneFrame& plane, bool masked, RenderWork& work);
  int make_mask(const Scene& scene, const ReceivedShadowDraw& draw, const Surface& surface,
                Mask& mask, RenderWork& work);
  void cover_levels(const Scene& scene, const ReceivedShadowDraw& draw, const Surface& surface,
                    const MaskCells& cells, Mask& mask, RenderWork& work);
  void cover_level(const Level& level, const MaskCells& cells, RenderWork& work);
  int draw_levels(const Scene& scene, const ReceivedShadowDraw& draw, const Surface& surface,
                  Mask& mask, RenderWork& work);
  int draw_level(const Level& level, int layer, const glm::mat4x3& camera) const;
  static int draw_shadow(const DrawContext& context, const FramePlan& plan, const Shown& shown,
                         Gathering gathering);
  int draw_casters(const DrawContext& context, const FramePlan& plan,
                   const std::vector<const Shown*>& casters) const;

  const ShadowGeometry& geometry_;
  LayerPainter& painter_;
  bool multisampled_ = false;
  double pixel_at_unit_depth_ = 0.0;                       // 1 m from the camera [m]
  std::map<std::pair<int, int>, Surface> surfaces_;        // receiver, plane
  std::map<std::tuple<int, int, int, int>, Masks> masks_;  // node, object, plane, receiver
  // (node, object, plane, receiver, level).
  std::map<std::tuple<int, int, int, int, int>, PreparedShadow> levels_;
  std::vector<Shown> shown_;  // in this frame
  std::vector<std::uint8_t> shares_;
  MaskCaster mask_caster_;
  MaskPicture mask_picture_;
  int calls_ = 0;  // draw calls of prepare()
  std::uint64_t frame_count_ = 0;
  std::uint64_t surfaces_made_ = 0;
};

}  // namespace penumbra
