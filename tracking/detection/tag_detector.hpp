// Detects tags in luma by libapriltag, guarded against images that crash it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct TagDetection {
  TagFamily family = TagFamily::tag36h11;
  int id = 0;
  // [px], pixel (0, 0) at the CENTRE of the top-left pixel. Order: (-s/2, -s/2), (s/2, -s/2),
  // (s/2, s/2), (-s/2, s/2) in the tag frame (x right, y up on the upright tag).
  std::array<Eigen::Vector2d, 4> corners_px;
};

struct TagDetectorOptions {
  // Width of the black border [cells]: 1 as in libapriltag's families, or 2 as on Kalibr's boards
  // (tag36h11 only). The corners are those of the border.
  int border_cells = 1;
  int max_corrected_bits = 1;  // wrong bits of a code that may be corrected: 0 or 1
};

class TagDetector {
 public:
  [[nodiscard]] static Result<TagDetector> create(std::span<const TagFamily> families,
                                                  const TagDetectorOptions& options = {});
  TagDetector(TagDetector&&) noexcept;
  TagDetector& operator=(TagDetector&&) noexcept;
  ~TagDetector();

  // Returns the tags, sorted by family, id and position. Single-threaded and deterministic.
  // Searches quads in an image reduced by `quad_decimate`: 1, 1.5 or an integer up to 8. Finds no
  // tags if the reduced image is smaller than 16 px.
  [[nodiscard]] std::vector<TagDetection> detect(ImageView luma, float quad_decimate = 1.0F);

 private:
  struct Impl;
  explicit TagDetector(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
