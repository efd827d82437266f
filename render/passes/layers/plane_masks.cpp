#include "render/passes/layers/plane_masks.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/assert.hpp"

namespace penumbra {
namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();

// Cell sizes, tuned by measurement, see docs/rendering.md#mask-cells.
constexpr double kPixelsPerMaskCell = 1.6;   // at the nearest shadow of the plane
constexpr double kPixelsPerSeenCell = 1.35;  // at the nearest visible point of a mask
constexpr std::int64_t kMaxMaskSide = 8192;  // cells
constexpr int kMaskCellsAtOnce = 1 << 20;    // rasterised together
// Up to this number of faces on a plane, direct drawing costs far less CPU time than a mask
// (docs/rendering.md#masks).
constexpr std::size_t kFewFaces = 500;

// Returns the cells of the box and a border of one cell, which contains no shadow.
MaskCells cells_about(const CellBox& box, double cell) {
  return MaskCells{cell, box.min().x() - 1, box.min().y() - 1,
                   static_cast<int>(box.sizes().x()) + 3, static_cast<int>(box.sizes().y()) + 3};
}

// Returns the mask value of each layer: the factor on the encoded value or, for a screen-door, the
// fraction of open pixels, which is exact in 8 bits.
glm::vec3 mask_light(const ShadowDraw& draw, Translucency mode) {
  const glm::vec3 light = layer_light(draw);
  if (mode != Translucency::mesh) return light;
  const auto open = [](float left) {
    return 1.0F - opaque_screen_door_pixels(left) / static_cast<float>(kScreenDoorPixels);
  };
  return {open(light.x), open(light.y), open(light.z)};
}

std::array<Eigen::Vector3d, 4> square_in_view(const ShadowDraw& draw, const FramePlan& plan) {
  const auto T_camera_table = plan.T_table_camera.inverse();
  std::array<Eigen::Vector3d, 4> square = draw.plane_frame.square_about(draw.centre, draw.radius);
  for (Eigen::Vector3d& corner : square) corner = T_camera_table * corner;
  return square;
}

}  // namespace

bool draws_directly(LayerDrawing layers, bool multisampled, std::size_t faces) {
  return layers == LayerDrawing::automatic && multisampled && faces <= kFewFaces;
}

PlaneMasks::PlaneMasks(const CameraModel& camera, bool multisampled)
    : multisampled_(multisampled),
      pixel_at_unit_depth_(1.0 / std::max(camera.parameters().fx, camera.parameters().fy)),
      frustum_(make_frustum(camera)) {
  GLint max_side = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &max_side);
  max_mask_side_ = std::min<std::int64_t>(kMaxMaskSide, max_side);
}

std::vector<PlaneMasks::PartCoverage>::iterator PlaneMasks::Plane::coverage_of(const MaskPart& part,
                                                                               double cell) {
  return std::ranges::find_if(coverages, [&](const PartCoverage& known) {
    return known.cell == cell && known.part.covers_same_as(part);
  });
}

const CellBox* PlaneMasks::DrawnMasks::bounds_of(const MaskPart& part) const {
  if (!made) return nullptr;
  const auto found = std::ranges::find_if(
      parts, [&part](const MaskPart& known) { return known.covers_same_as(part); });
  return found == parts.end() ? nullptr : &bounds[static_cast<std::size_t>(found - parts.begin())];
}

std::shared_ptr<PlaneMasks::DrawnMask> PlaneMasks::DrawnMasks::mask_of(
    const MaskCells& cells, const std::vector<MaskPart>& wanted) const {
  const auto found = std::ranges::find_if(masks, [&](const std::shared_ptr<DrawnMask>& known) {
    return known->cells == cells && std::ranges::equal(known->parts, wanted, &MaskPart::same_as);
  });
  return found == masks.end() ? nullptr : *found;
}

std::shared_ptr<PlaneMasks::DrawnMask> PlaneMasks::DrawnMasks::unused_mask() {
  const auto spare = std::ranges::find_if(
      masks, [](const std::shared_ptr<DrawnMask>& mask) { return mask.use_count() == 1; });
  if (spare == masks.end()) return std::make_shared<DrawnMask>();
  std::shared_ptr<DrawnMask> mask = std::move(*spare);
  masks.erase(spare);
  return mask;
}

void PlaneMasks::plan(const Scene& scene, const FramePlan& plan, Translucency mode,
                      CasterCache& casters, RenderWork& work) {
  for (auto& [plane, mask] : planes_) mask.in_use = false;
  if (plan.layers == LayerDrawing::direct) return;
  if (mode == Translucency::geometry_mesh) return;  // layers are marked in the stencil instead
  for (const PlaneReceiver& receiver : plan.receivers) {
    const std::optional<double> depth = depth_of(scene, plan, receiver.plane, casters, work);
    if (!depth) continue;
    Plane& plane = planes_[receiver.plane];
    plane.in_use = true;
    plane.depth = *depth;
  }
}

bool PlaneMasks::has_mask(int plane) const {
  const auto found = planes_.find(plane);
  return found != planes_.end() && found->second.in_use;
}

// Returns the depth of a plane's nearest shadow [m]; nullopt if there is no shadow or if one can't
// be in a mask. Also considers shadows out of view, because culling one must not change how the
// others are drawn.
std::optional<double> PlaneMasks::depth_of(const Scene& scene, const FramePlan& plan, int plane,
                                           CasterCache& casters, RenderWork& work) const {
  double in_view = kNone;
  double anywhere = kNone;
  std::size_t faces = 0;
  bool layers = false;
  bool fields = false;
  int not_masked = -1;  // object
  const auto is_maskable = [&](const ShadowDraw& draw) {
    fields = fields || draw.technique == ShadowTechnique::field;
    layers = layers || traits_of(draw.technique).has_penumbra;
    CachedCaster& caster = casters.caster_of(scene, draw);
    faces += caster.mesh.indices.size() / 3;
    if (caster.is_empty()) return true;
    if (!CasterCache::can_be_masked(draw, caster)) {
      not_masked = draw.object;
      return false;
    }
    if (!has_one_light_size(draw) && layer_sources(draw, caster) == LayerSources{}) return true;
    const std::array<Eigen::Vector3d, 4> square = square_in_view(draw, plan);
    double nearest = kNone;
    for (const Eigen::Vector3d& corner : square) nearest = std::min(nearest, corner.z());
    anywhere = std::min(anywhere, nearest);
    if (!draw.off_outline && !frustum_.misses(square)) in_view = std::min(in_view, nearest);
    return true;
  };
  bool all_maskable = true;
  for (const std::vector<ShadowDraw>* draws : {&plan.shadows, &plan.skipped_shadows}) {
    for (const ShadowDraw& draw : *draws) {
      if (draw.plane == plane && !is_maskable(draw)) all_maskable = false;
    }
  }
  // If all shadows are simple, draws them directly, in one draw call.
  if (!layers && plan.layers == LayerDrawing::automatic) return std::nullopt;
  if (!all_maskable) {
    work.skipped.push_back({SkipReason::mask_impossible, plane, not_masked});
    return std::nullopt;
  }
  // Multisampling would not smooth the edges of a directly drawn field.
  if (!fields && draws_directly(plan.layers, multisampled_, faces)) return std::nullopt;
  if (anywhere == kNone) return std::nullopt;
  return in_view == kNone ? anywhere : in_view;
}

int PlaneMasks::half_octave_at(double depth, double pixels) const {
  return static_cast<int>(std::floor(
      2.0 * std::log2(pixels * pixel_at_unit_depth_ * std::max(depth, kNearestDistance))));
}

PlaneMasks::LayOut PlaneMasks::layout_for(const FramePlan& plan, const PlaneFrame& frame,
                                          int half_octave) const {
  const auto T_camera_table = plan.T_table_camera.inverse();
  return [this, &plan, &frame, half_octave, T_camera_table](std::span<const CellBox> bounds) {
    return lay_out_masks(bounds, half_octave, max_mask_side_, [&](const Eigen::AlignedBox2d& box) {
      std::array<Eigen::Vector3d, 4> corners = {
          frame.lift(box.min().x(), box.min().y()), frame.lift(box.max().x(), box.min().y()),
          frame.lift(box.max().x(), box.max().y()), frame.lift(box.min().x(), box.max().y())};
      for (Eigen::Vector3d& corner : corners) corner = T_camera_table * corner;
      VisiblePart part;
      double nearest = kNone;
      for (const Eigen::Vector3d& corner : frustum_.clipped_to_view(corners)) {
        nearest = std::min(nearest, corner.z());
        part.box.extend(frame.to_plane(plan.T_table_camera * corner).head<2>());
      }
      if (!part.box.isEmpty()) part.half_octave = half_octave_at(nearest, kPixelsPerSeenCell);
      return part;
    });
  };
}

void PlaneMasks::make(const FramePlan& plan, Translucency mode, std::span<const ShadowItem> items,
                      RenderWork& work) {
  for (auto& [plane, mask] : planes_) {
    if (mask.in_use) make_plane(plan, mode, plane, items, work);
  }
}

void PlaneMasks::make_plane(const FramePlan& plan, Translucency mode, int plane,
                            std::span<const ShadowItem> items, RenderWork& work) {
  Plane& mask = planes_.at(plane);
  std::vector<MaskPart> parts;
  for (std::size_t i = 0; i < plan.shadows.size(); ++i) {
    const ShadowDraw& draw = plan.shadows[i];
    const PreparedShadow& prepared = *items[i].prepared;
    if (draw.plane != plane || !prepared.valid) continue;
    // Excludes shadows out of view, which would enlarge the mask. Stored kernels: bounds unknown.
    if (draw.off_outline ||
        (!prepared.key.kernels.stored && frustum_.misses(square_in_view(draw, plan))))
      continue;
    const MaskPart part = MaskPart::of(draw, *items[i].caster, prepared, mask_light(draw, mode));
    if (!part.covers_nothing()) parts.push_back(part);
  }
  // Cell sizes are powers of sqrt(2) m, so that a moving camera rarely requires a new mask. They
  // depend only on the current frame. A camera at rest may jitter between two sizes, so both masks
  // are kept.
  const int half_octave = half_octave_at(mask.depth, kPixelsPerMaskCell);
  const auto receiver = std::ranges::find(plan.receivers, plane, &PlaneReceiver::plane);
  const LayOut lay_out = layout_for(plan, receiver->frame, half_octave);
  const auto matches = [&](const DrawnMasks& masks) {
    return masks.made && masks.half_octave == half_octave &&
           std::ranges::equal(masks.parts, parts, &MaskPart::same_as) &&
           (!masks.layout.of_view || masks.layout == lay_out(masks.bounds));
  };
  if (!matches(mask.latest)) std::swap(mask.latest, mask.earlier);
  const std::int64_t kept_before = work[Counter::layer_masks_kept];
  if (matches(mask.latest)) {
    work[Counter::layer_masks_kept] += static_cast<std::int64_t>(mask.latest.masks.size());
  } else {
    draw_masks(half_octave, std::move(parts), lay_out, mask, work);
  }
  if (work[Counter::layer_masks_kept] > kept_before) {
    work.kept.push_back({KeepReason::layer_mask, plane});
  }
}

void PlaneMasks::draw_masks(int half_octave, std::vector<MaskPart> drawn, const LayOut& lay_out,
                            Plane& plane, RenderWork& work) {
  DrawnMasks older = std::move(plane.latest);
  DrawnMasks& made = plane.latest = {};
  made.made = true;
  made.parts = std::move(drawn);
  made.half_octave = half_octave;
  const std::vector<MaskPart>& parts = made.parts;
  ++plane.times_drawn;
  if (casters_.size() < parts.size()) casters_.resize(parts.size());
  // The coverage of parts that did not move since the previous masks is kept, if other parts moved.
  std::vector<bool> unmoved(parts.size(), false);
  for (std::size_t i = 0; parts.size() > 1 && i < parts.size(); ++i) {
    unmoved[i] = std::ranges::any_of(plane.drawn_before, [&](const MaskPart& before) {
      return before.covers_same_as(parts[i]);
    });
  }
  plane.drawn_before = parts;

  std::vector<std::optional<MaskPart::Faces>> faces(parts.size());
  std::vector<double> projected(parts.size(), 0.0);  // cell size of each part's projection
  const auto project = [&](std::size_t i, double cell) {
    if (projected[i] == cell) return;
    if (!faces[i]) faces[i] = parts[i].face_images(work);
    parts[i].project(*faces[i], cell, casters_[i], work);
    projected[i] = cell;
  };
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const CellBox* known = nullptr;
    for (const DrawnMasks* before : {&older, &plane.earlier}) {
      if (unmoved[i] && before->half_octave == half_octave && known == nullptr)
        known = before->bounds_of(parts[i]);
    }
    if (known == nullptr) project(i, cell_size(half_octave));
    made.bounds.push_back(known != nullptr ? *known : casters_[i].bounds());
  }

  made.layout = lay_out(made.bounds);
  for (const MaskLayout::Group& group : made.layout.groups) {
    std::vector<MaskPart> of_group;
    for (const std::size_t i : group.parts) of_group.push_back(parts[i]);
    std::shared_ptr<DrawnMask> mask;
    for (const DrawnMasks* before : {&older, &plane.earlier}) {
      if (!mask) mask = before->mask_of(group.cells, of_group);
    }
    if (mask) {
      ++work[Counter::layer_masks_kept];
      made.masks.push_back(mask);
      continue;
    }
    const double cell = group.cells.size;
    std::vector<bool> is_kept(of_group.size(), false);
    for (std::size_t k = 0; k < of_group.size(); ++k) {
      const std::size_t i = group.parts[k];
      is_kept[k] = unmoved[i] && !group.cut && of_group.size() > 1;
      if (is_kept[k] && plane.coverage_of(parts[i], cell) != plane.coverages.end()) continue;
      project(i, cell);
      if (!is_kept[k]) continue;
      PartCoverage cover{parts[i], cell, {}, 0};
      const CellBox& bounds = casters_[i].bounds();
      if (!bounds.isEmpty()) {
        raster_.begin(cells_about(bounds, cell));
        parts[i].cover(casters_[i], raster_);
        raster_.take(cover.cover);
      }
      plane.coverages.push_back(std::move(cover));
    }
    mask = older.unused_mask();
    mask->cells = group.cells;
    mask->parts = std::move(of_group);
    fill_mask(group, is_kept, plane, *mask);
    made.masks.push_back(std::move(mask));
    ++work[Counter::layer_masks_drawn];
  }
  // Keeps coverage for the two most recent masks: a camera may jitter between two cell sizes.
  std::erase_if(plane.coverages,
                [&](const PartCoverage& cover) { return cover.last_used + 1 < plane.times_drawn; });
}

void PlaneMasks::fill_mask(const MaskLayout::Group& group, const std::vector<bool>& is_kept,
                           Plane& plane, DrawnMask& mask) {
  const MaskCells& cells = mask.cells;
  const auto width = static_cast<std::size_t>(cells.width);
  mask_values_.resize(width * static_cast<std::size_t>(cells.height));
  // A clipped mask may be large, so bands of rows limit the memory of the sums.
  const int rows =
      group.cut ? std::clamp(kMaskCellsAtOnce / cells.width, 1, cells.height) : cells.height;
  for (int first_row = 0; first_row < cells.height; first_row += rows) {
    MaskCells band = cells;
    band.v += first_row;
    band.height = std::min(rows, cells.height - first_row);
    cover_band(group, is_kept, band, plane, mask,
               std::span(mask_values_)
                   .subspan(width * static_cast<std::size_t>(first_row),
                            width * static_cast<std::size_t>(band.height)));
  }
  mask.texture.upload(cells, mask_values_);
}

void PlaneMasks::cover_band(const MaskLayout::Group& group, const std::vector<bool>& is_kept,
                            const MaskCells& band, Plane& plane, const DrawnMask& mask,
                            std::span<std::uint8_t> codes) {
  const std::vector<MaskPart>& parts = mask.parts;
  std::vector<bool> done(parts.size(), false);
  bool first = true;
  for (std::size_t start = 0; start < parts.size(); ++start) {
    if (done[start]) continue;
    const glm::vec3 light = parts[start].light;
    raster_.begin(band);
    for (std::size_t k = start; k < parts.size(); ++k) {
      if (done[k] || parts[k].light != light) continue;
      done[k] = true;
      if (!is_kept[k]) {
        parts[k].cover(casters_[group.parts[k]], raster_);
        continue;
      }
      const auto known = plane.coverage_of(parts[k], mask.cells.size);
      PENUMBRA_ASSERT(known != plane.coverages.end());
      known->last_used = plane.times_drawn;
      raster_.cover(known->cover);
    }
    if (first) {
      raster_.finish(light, codes);
      first = false;
      continue;
    }
    // Parts with different `light` are combined by their minimum.
    raster_.finish(light, other_values_);
    std::ranges::transform(codes, other_values_, codes.begin(),
                           [](std::uint8_t a, std::uint8_t b) { return std::min(a, b); });
  }
}

int PlaneMasks::draw(const FramePlan& plan, const PlaneReceiver& receiver, const LensUniforms& lens,
                     const MaskQuad& quad, RenderWork& work) {
  int calls = 0;
  for (const std::shared_ptr<DrawnMask>& mask : planes_.at(receiver.plane).latest.masks) {
    work[Counter::mask_pieces_skipped] += quad.draw(
        mask->texture, lens, camera_from_plane(plan.T_table_camera, receiver.frame), !plan.reuse);
    ++calls;
  }
  return calls;
}

}  // namespace penumbra
