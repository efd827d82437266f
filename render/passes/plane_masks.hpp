// Masks of planes: which planes are drawn as masks, how these are laid out, and which are kept from
// earlier frames.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/passes/caster_cache.hpp"
#include "render/passes/mask_part.hpp"
#include "render/passes/mask_quad.hpp"
#include "render/passes/shadow_geometry.hpp"
#include "render/shadow/masks/silhouette_mask.hpp"

namespace penumbra {

// Whether casters with this number of faces are drawn directly, not masked: where pixels have
// several samples, which smooth edges too (docs/rendering.md#masks).
[[nodiscard]] bool draws_directly(LayerDrawing layers, bool multisampled, std::size_t faces);

class PlaneMasks {
 public:
  // `multisampled`: pixels of the framebuffer have several samples.
  PlaneMasks(const CameraModel& camera, bool multisampled);

  // Decides which planes have a mask in this frame. All shadows of a plane are in its mask, or none
  // is: where they overlap the darkest layer counts, once.
  void plan(const Scene& scene, const FramePlan& plan, Translucency mode, CasterCache& casters,
            RenderWork& work);
  [[nodiscard]] bool has_mask(int plane) const;
  // True if its mask shows nothing.
  [[nodiscard]] bool is_empty(int plane) const { return planes_.at(plane).now.masks.empty(); }
  // Makes the masks of those planes, or keeps them. `items`: of plan.shadows, prepared for masks.
  void make(const FramePlan& plan, Translucency mode, std::span<const ShadowItem> items,
            RenderWork& work);
  // Draws a plane's masks; adds the number of pieces that darken nothing. Number of draw calls.
  int draw(const FramePlan& plan, const PlaneReceiver& receiver, const LensUniforms& lens,
           const MaskQuad& quad, RenderWork& work);
  void clear() { planes_.clear(); }

 private:
  struct DrawnMask {
    MaskCells cells;
    std::vector<MaskPart> parts;
    MaskTexture texture;
  };
  // The masks of a plane, and what they were made for.
  struct DrawnMasks {
    bool made = false;
    std::vector<MaskPart> parts;
    int half_octave = 0;          // of cells
    std::vector<CellBox> bounds;  // of each part, in these
    MaskLayout layout;
    std::vector<std::shared_ptr<DrawnMask>> masks;  // of each of its groups
  };
  // What one of several casters covers of a mask's cells: the others may move.
  struct PartCover {
    MaskPart part;
    double cell = 0.0;
    MaskCover cover;
    std::uint64_t last_used = 0;
  };
  struct Plane {
    DrawnMasks now, other;               // of this frame, and those shown before it
    bool in_use = false;                 // in this frame
    double depth = 0.0;                  // of the nearest shadow that counts [m]
    std::vector<MaskPart> drawn_before;  // in the mask that was made last
    std::vector<PartCover> covers;       // of parts that rested from one mask to the next
    std::uint64_t times_drawn = 0;
    [[nodiscard]] std::vector<PartCover>::iterator cover_of(const MaskPart& part, double cell);
  };
  // Lays out masks of parts in these bounds, for the camera as it is.
  using LayOut = std::function<MaskLayout(std::span<const CellBox>)>;

  [[nodiscard]] std::optional<double> depth_of(const Scene& scene, const FramePlan& plan, int plane,
                                               CasterCache& casters, RenderWork& work) const;
  // The half octave of cells that are no larger than so many pixels, at this depth [m].
  [[nodiscard]] int cell_at(double depth, double pixels) const;
  [[nodiscard]] LayOut layout_for(const FramePlan& plan, const PlaneFrame& frame,
                                  int half_octave) const;
  void make_plane(const FramePlan& plan, Translucency mode, int plane,
                  std::span<const ShadowItem> items, RenderWork& work);
  void draw_masks(int half_octave, std::vector<MaskPart> parts, const LayOut& lay_out, Plane& plane,
                  RenderWork& work);
  // Fills a mask with the parts of a group. `noted`: of these, whether their cover is known.
  void fill_mask(const MaskLayout::Group& group, const std::vector<bool>& noted, Plane& plane,
                 DrawnMask& mask);
  void cover_band(const MaskLayout::Group& group, const std::vector<bool>& noted,
                  const MaskCells& band, Plane& plane, const DrawnMask& mask,
                  std::span<std::uint8_t> codes);

  bool multisampled_ = false;
  double pixel_at_unit_depth_ = 0.0;  // 1 m from the camera [m]
  std::int64_t most_side_ = 0;        // cells along a side, of a texture
  ViewFrustum frustum_;
  std::map<int, Plane> planes_;
  std::vector<MaskCaster> casters_;
  MaskPicture picture_;
  std::vector<std::uint8_t> codes_, lighter_codes_;
};

}  // namespace penumbra
