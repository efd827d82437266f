// Luma -> tags. libapriltag behind RAII, guarded against what makes it crash.
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
  // [px], pixel (0, 0) at the CENTRE of the top-left pixel (libapriltag's own are 0.5 px larger;
  // converted here and nowhere else). Order: (-s/2, -s/2), (s/2, -s/2), (s/2, s/2), (-s/2, s/2) in
  // the tag frame (x right, y up on the upright tag).
  std::array<Eigen::Vector2d, 4> corners_px;
  int hamming = 0;               // corrected bits
  float decision_margin = 0.0F;  // larger is surer
};

struct TagDetectorOptions {
  float quad_decimate = 1.0F;  // 1: full resolution; 2: quads are searched at half
  bool refine_edges = true;
  double decode_sharpening = 0.25;
  int max_hamming = 1;  // detections with more corrected bits are dropped
  // Width of the black border [cells]: 1 as libapriltag's families have it, or 2 as the boards of
  // the Kalibr calibrator, whose corners are then those of the wider square. 2: tag36h11 only.
  int border_cells = 1;
};

class TagDetector {
 public:
  [[nodiscard]] static Result<TagDetector> create(std::span<const TagFamily> families,
                                                  const TagDetectorOptions& options = {});
  TagDetector(TagDetector&&) noexcept;
  TagDetector& operator=(TagDetector&&) noexcept;
  ~TagDetector();

  // Tags of the asked families. Images under 16 px (or under 16 px after decimation) give none:
  // libapriltag 3.3.0 crashes on them. Single-threaded and deterministic; order is by (family, id,
  // position).
  [[nodiscard]] std::vector<TagDetection> detect(ImageView luma);
  // The same with quads searched at another decimation than that of the options, one that they
  // could have.
  [[nodiscard]] std::vector<TagDetection> detect(ImageView luma, float quad_decimate);

 private:
  struct Impl;
  explicit TagDetector(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
