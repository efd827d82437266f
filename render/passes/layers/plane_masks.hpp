// Chooses, lays out, draws and reuses the masks of planes.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "render/passes/layers/mask_part.hpp"
#include "render/passes/layers/mask_quad.hpp"

namespace penumbra {

// Returns true if casters with this number of faces are drawn directly instead of masked, because
// multisampling also smooths their edges (docs/rendering.md#masks).
[[nodiscard]] bool draws_directly(LayerDrawing layers, bool multisampled, std::size_t faces);

class PlaneMasks {
 public:
  // `multisampled`: whether the framebuffer is.
  PlaneMasks(const CameraModel& camera, bool multisampled);

  // Decides which planes have a mask in this frame. A mask contains all shadows of its plane,
  // because the darkest of overlapping layers counts.
  void plan(const Scene& scene, const FramePlan& plan, Translucency mode, CasterCache& casters,
            RenderWork& work);
  [[nodiscard]] bool has_mask(int plane) const;
  // Returns true if the plane's mask is empty.
  [[nodiscard]] bool is_empty(int plane) const { return planes_.at(plane).latest.masks.empty(); }
  // Makes or reuses the masks that plan() chose. `items`: one per plan.shadows, prepared for masks.
  void make(const FramePlan& plan, Translucency mode, std::span<const ShadowItem> items,
            RenderWork& work);
  // Draws a plane's masks. Returns the number of draw calls.
  int draw(const FramePlan& plan, const PlaneReceiver& receiver, const LensUniforms& lens,
           const MaskQuad& quad, RenderWork& work);
  void clear() { planes_.clear(); }

 private:
  struct DrawnMask {
    MaskCells cells;
    std::vector<MaskPart> parts;
    MaskTexture texture;
  };
  struct DrawnMasks {
    bool made = false;
    std::vector<MaskPart> parts;
    int half_octave = 0;          // see cell_size()
    std::vector<CellBox> bounds;  // one per part [cells]
    MaskLayout layout;
    std::vector<std::shared_ptr<DrawnMask>> masks;  // one per group
    // Returns the bounds of the part that covers the same cells; null if there is none.
    [[nodiscard]] const CellBox* bounds_of(const MaskPart& part) const;
    // Returns the mask with the same cells and parts; null if there is none.
    [[nodiscard]] std::shared_ptr<DrawnMask> mask_of(const MaskCells& cells,
                                                     const std::vector<MaskPart>& wanted) const;
    // Returns an unused mask for reuse of its storage, or a new one.
    [[nodiscard]] std::shared_ptr<DrawnMask> unused_mask();
  };
  // The coverage of a mask's cells by one caster.
  struct PartCoverage {
    MaskPart part;
    double cell = 0.0;
    MaskCover cover;
    std::uint64_t last_used = 0;
  };
  struct Plane {
    DrawnMasks latest, earlier;           // masks of this frame, masks shown before
    bool in_use = false;                  // in this frame
    double depth = 0.0;                   // depth of the nearest shadow [m]
    std::vector<MaskPart> drawn_before;   // parts of the previous mask
    std::vector<PartCoverage> coverages;  // coverage by parts unchanged since the previous mask
    std::uint64_t times_drawn = 0;
    [[nodiscard]] std::vector<PartCoverage>::iterator coverage_of(const MaskPart& part,
                                                                  double cell);
  };
  // Lays out masks of parts with these bounds, for the current camera.
  using LayOut = std::function<MaskLayout(std::span<const CellBox>)>;

  [[nodiscard]] std::optional<double> depth_of(const Scene& scene, const FramePlan& plan, int plane,
                                               CasterCache& casters, RenderWork& work) const;
  // Returns the half octave of the largest cells that are no larger than `pixels` at `depth` [m].
  [[nodiscard]] int half_octave_at(double depth, double pixels) const;
  [[nodiscard]] LayOut layout_for(const FramePlan& plan, const PlaneFrame& frame,
                                  int half_octave) const;
  void make_plane(const FramePlan& plan, Translucency mode, int plane,
                  std::span<const ShadowItem> items, RenderWork& work);
  void draw_masks(int half_octave, std::vector<MaskPart> parts, const LayOut& lay_out, Plane& plane,
                  RenderWork& work);
  // Fills a mask with the parts of a group. The flags: whether the part's coverage is kept.
  void fill_mask(const MaskLayout::Group& group, const std::vector<bool>& is_kept, Plane& plane,
                 DrawnMask& mask);
  void cover_band(const MaskLayout::Group& group, const std::vector<bool>& is_kept,
                  const MaskCells& band, Plane& plane, const DrawnMask& mask,
                  std::span<std::uint8_t> codes);

  bool multisampled_ = false;
  double pixel_at_unit_depth_ = 0.0;  // size of a pixel 1 m from the camera [m]
  std::int64_t max_mask_side_ = 0;    // maximum number of cells along a texture's side
  ViewFrustum frustum_;
  std::map<int, Plane> planes_;
  std::vector<MaskCaster> casters_;
  MaskRaster raster_;
  std::vector<std::uint8_t> mask_values_, other_values_;
};

}  // namespace penumbra
