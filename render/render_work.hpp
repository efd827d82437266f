// Work of a frame: counters, and reasons for skipped passes and reused results.
#pragma once

#include <array>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace penumbra {

struct Scene;

// In the order of kCounterNames.
enum class Counter : std::size_t {
  shadow_vertices,      // vertices that the CPU projected or clipped for shadows
  kernel_generations,   // sets of kernels, and of part lights, made for a tilt
  kernels_carried,      // sets of kernels carried to a shape of an animation
  reprojections,        // shadows drawn with the geometry of an earlier frame
  triples_recomputed,   // shadows with new geometry
  proxy_shadows,        // drawn from a reduced mesh
  proxy_checks,         // comparisons of a reduced mesh with its model
  proxy_faces_saved,    // faces that proxy_shadows did not draw, over all their layers
  layer_masks_drawn,    // masks of the layers on a plane
  layer_masks_kept,     // layer masks reused from an earlier frame
  mask_pieces_skipped,  // pieces of layer masks without effect
  masks_drawn,          // masks of shadows on phantoms and objects, one per level
  masks_kept,           // masks on phantoms and objects, reused from an earlier frame
  // Reused video frames are not counted.
  video_copies,             // video frames copied to the GPU, or converted by the CPU
  video_imports,            // video frames read in the camera's buffer
  pixel_buffer_uploads,     // video frames copied through pixel buffers
  pixel_buffer_read_backs,  // images of request_image() read through pixel buffers
  faces_tested,             // faces of the kernel sets made in this frame
  faces_twisted,            // tested faces that are twisted in some layer
  passes_drawn,             // passes with draw calls, including the video
  passes_skipped,           // entries of the plan's and the passes' `skipped`
  edge_pixels,              // pixels that were changed to smooth edges
  draw_calls,               // OpenGL draw calls; must be last
};
// The counters' keys in the report.
inline constexpr auto kCounterNames = std::to_array<std::string_view>(
    {"shadow_vertices",         "kernel_generations", "kernels_carried",     "reprojections",
     "triples_recomputed",      "proxy_shadows",      "proxy_checks",        "proxy_faces_saved",
     "layer_masks_drawn",       "layer_masks_kept",   "mask_pieces_skipped", "phantom_masks_drawn",
     "phantom_masks_kept",      "video_copies",       "video_imports",       "pixel_buffer_uploads",
     "pixel_buffer_read_backs", "kernel_faces",       "twisted_faces",       "passes_drawn",
     "passes_skipped",          "edge_pixels",        "draw_calls"});
static_assert(kCounterNames.size() == static_cast<std::size_t>(Counter::draw_calls) + 1);

class RenderCounters {
 public:
  [[nodiscard]] std::int64_t& operator[](Counter counter) {
    return values_[static_cast<std::size_t>(counter)];
  }
  [[nodiscard]] std::int64_t operator[](Counter counter) const {
    return values_[static_cast<std::size_t>(counter)];
  }
  RenderCounters& operator+=(const RenderCounters& other) {
    for (std::size_t i = 0; i < values_.size(); ++i) values_[i] += other.values_[i];
    return *this;
  }

 private:
  std::array<std::int64_t, kCounterNames.size()> values_{};
};

// Reasons for not drawing. The comments give the kinds of SkippedPass::subject and `other`.
enum class SkipReason {
  no_pose,                 // -
  faded_out,               // -
  object_group_not_seen,   // object
  plane_group_not_seen,    // plane
  object_out_of_view,      // object
  shape_missing,           // object
  technique_none,          // node
  camera_behind_plane,     // plane
  casts_no_shadow,         // object
  shadow_misses_phantoms,  // object
  shadow_misses_objects,   // object
  receiver_blends,         // object
  no_light,                // node
  light_below_plane,       // light
  too_many_lights,         // light
  volume_out_of_view,      // object
  rays_out_of_view,        // object
  shadow_below_plane,      // object
  shadow_above_light,      // object
  shadow_off_receiver,     // object
  shadow_out_of_view,      // object
  umbra_vanished,          // object
  mask_impossible,         // plane, object
  field_too_coarse,        // object
  kernels_not_carried,     // object
  light_inside_caster,     // object, light
  volume_too_far,          // object, light
  count                    // number of reasons
};

struct SkippedPass {
  SkipReason reason = SkipReason::no_pose;
  int subject = -1, other = -1;  // indices into the scene
  friend auto operator<=>(const SkippedPass&, const SkippedPass&) = default;
};

// Results reused from an earlier frame.
enum class KeepReason {
  video,         // the frame was already on the GPU
  layer_mask,    // plane
  phantom_mask,  // receiver, caster
  count          // number of reasons
};

struct KeptResult {
  KeepReason reason = KeepReason::video;
  int subject = -1, other = -1;
};

// Returns the key in the report: "object_out_of_view", "video", ...
[[nodiscard]] std::string_view key_of(SkipReason reason);
[[nodiscard]] std::string_view key_of(KeepReason reason);
// Returns a text for users: "rotor: outside the view".
[[nodiscard]] std::string text_of(const SkippedPass& skipped, const Scene& scene);
[[nodiscard]] std::string text_of(const KeptResult& kept, const Scene& scene);

// Maximum distance of shadow volumes from the table's origin [m]. A camera up to 8 m from the
// origin has its far plane beyond it.
inline constexpr double kVolumeReach = 12.0;

struct RenderWork {
  RenderCounters counters;
  std::vector<SkippedPass> skipped;  // found by the passes from the geometry
  std::vector<KeptResult> kept;

  [[nodiscard]] std::int64_t& operator[](Counter counter) { return counters[counter]; }
  [[nodiscard]] std::int64_t operator[](Counter counter) const { return counters[counter]; }
};

}  // namespace penumbra
