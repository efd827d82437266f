// The tags of one rigid group, and the camera.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/detection/tag_search.hpp"

namespace penumbra {

struct RigidTags {
  CameraModel camera;
  std::vector<MappedTag> tags;  // same order as in the aligner

  [[nodiscard]] const MappedTag& operator[](int index) const {
    return tags[static_cast<std::size_t>(index)];
  }
  // Returns the number of tags that face the camera, inside the image, large enough to be read.
  [[nodiscard]] int in_view(const MapFromCamera& pose) const;
  // Returns the box around the tags with a margin; nullopt if it covers most of the image.
  [[nodiscard]] std::optional<PixelBox> box_about(const MapFromCamera& pose) const;
  // Returns the mean distance between the verified tags' corners, projected by two poses [px].
  [[nodiscard]] double corner_distance_px(const MapFromCamera& a, const MapFromCamera& b,
                                          std::span<const TagAlignment> seen) const;
};

// An alignment that can be repeated with other rejected tags or another motion.
struct Alignment {
  TagAligner& aligner;
  AlignmentInput input;
  bool with_search = true;  // true: align(); false: refine()
  AlignmentResult result = {};

  void run() { result = align(); }
  // Returns an alignment without these tags. Keeps `result`; sets input.rejected for later runs.
  [[nodiscard]] AlignmentResult tried_without(std::span<const int> rejected) {
    input.rejected = rejected;
    return align();
  }
  void run_without(std::span<const int> rejected) { result = tried_without(rejected); }

 private:
  [[nodiscard]] AlignmentResult align() {
    return with_search ? aligner.align(input) : aligner.refine(input);
  }
};

// Returns true if the number of inconsistent tags exceeds half the number of verified tags.
[[nodiscard]] bool many_are_inconsistent(const AlignmentResult& result);

// Returns a prior covariance so large that it does not constrain the pose.
[[nodiscard]] Matrix6d uninformative_covariance();

}  // namespace penumbra
