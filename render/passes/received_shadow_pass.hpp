// Layered, field and simple shadows on phantoms and on other virtual objects
// (docs/rendering.md#shadows-on-receivers). For each shadow that may reach a receiver, masks are
// made at several heights above the shadow's plane (levels), as on planes at these heights. They
// are rasterised on the CPU or drawn with multisampling. Each pixel of the receiver is then
// darkened once, by the darkest shadow over it, with Lambert's law.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "render/gl/mask_stack.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/layers/layer_painter.hpp"
#include "render/passes/layers/mask_part.hpp"
#include "render/shadow/layers/receiving_levels.hpp"

namespace penumbra {

class ReceivedShadowPass : public Pass {
 public:
  // `geometry` and `painter` must outlive the pass. `multisampled`: whether the framebuffer is.
  ReceivedShadowPass(const CameraModel& camera, const ShadowGeometry& geometry,
                     LayerPainter& painter, bool multisampled);

  // Makes the masks of changed shadows, in their own framebuffers.
  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  // A receiver in the coordinates of a shadow plane.
  struct Surface {
    Placement T_table_object;
    double pose_s = 0.0;  // see PosedModel
    PlaneFrame plane;
    ReceivingSurface faces;
    std::uint64_t version = 0;  // unique; 0: not computed
    std::uint64_t last_used = 0;
  };
  // Inputs of the masks of one caster's shadow on one receiver.
  struct MaskInputs {
    ShadowShape shadow;
    std::uint64_t surface = 0;         // Surface::version
    double top = 0.0;                  // ReceivedShadowDraw::top
    double texel = 0.0;                // texel size for the current view [m]
    double max_texels_per_pair = 0.0;  // limit for this pair of caster and receiver
    bool on_cpu = false;               // rasterised on the CPU instead of drawn
    friend bool operator==(const MaskInputs&, const MaskInputs&) = default;
  };
  struct Mask {
    std::optional<MaskInputs> made_for;
    std::vector<double> levels;
    bool has_shadow = false;         // some level is non-empty
    Eigen::Vector2d origin, extent;  // corner and size of the mask on the plane [m]
    MaskStack level_masks;
  };
  // The two most recent masks, because a camera at rest may jitter between two texel sizes.
  struct Masks {
    Mask latest, earlier;
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
  // Returns true if masks are rasterised on the CPU instead of drawn.
  [[nodiscard]] bool draws_on_cpu(const Scene& scene, const FramePlan& plan,
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
  static int draw_shadow(const DrawContext& context, const FramePlan& plan, const Shown& shown,
                         Gathering gathering);
  int draw_casters(const DrawContext& context, const FramePlan& plan,
                   const std::vector<const Shown*>& casters) const;

  const ShadowGeometry& geometry_;
  LayerPainter& painter_;
  bool multisampled_ = false;
  double pixel_at_unit_depth_ = 0.0;                 // size of a pixel 1 m from the camera [m]
  std::map<std::pair<int, int>, Surface> surfaces_;  // receiver, plane
  std::map<std::tuple<int, int, int, int>, Masks> masks_;  // node, object, plane, receiver
  // (node, object, plane, receiver, level).
  std::map<std::tuple<int, int, int, int, int>, PreparedShadow> levels_;
  std::vector<Shown> shown_;            // in this frame
  std::vector<std::uint8_t> coverage_;  // coverage of each cell by the layers, RGBA
  MaskCaster mask_caster_;
  MaskRaster mask_raster_;
  int calls_ = 0;  // draw calls of prepare()
  std::uint64_t frame_count_ = 0;
  std::uint64_t surfaces_made_ = 0;
};

}  // namespace penumbra
