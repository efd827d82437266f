// What the passes counted in a frame, and what they skipped or kept.
#pragma once

#include <cstdint>
#include <vector>

#include "render/frame_plan.hpp"

namespace penumbra {

struct ShadowWork {
  std::int64_t vertices = 0;            // that the CPU projected and clipped
  std::int64_t kernel_generations = 0;  // kernel sets, and sets of part lights, for a tilt
  // Shadows of this plan whose geometry is that of a plan before, in its place or slid and turned;
  // and the others.
  std::int64_t reprojections = 0;
  std::int64_t recomputed = 0;
  std::int64_t proxy_shadows = 0;      // shadows that a reduced mesh cast
  std::int64_t proxy_checks = 0;       // comparisons of a reduced mesh with its model
  std::int64_t proxy_faces_saved = 0;  // over the layers drawn
  std::int64_t faces_tested = 0;       // of the kernel sets made: for twists
  std::int64_t faces_twisted = 0;
  std::int64_t layer_masks_drawn = 0;  // masks of a plane's layers
  std::int64_t layer_masks_kept = 0;
  std::int64_t mask_pieces_skipped = 0;
  std::int64_t masks_drawn = 0;  // masks of the shadows on a receiver, one for each level
  std::int64_t masks_kept = 0;
  std::vector<SkippedPass> skipped;  // known only from the geometry
  std::vector<KeptPart> kept;
};

}  // namespace penumbra
