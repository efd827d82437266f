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
  // Number of tags that this pose shows from in front, inside the image, large enough to be read.
  [[nodiscard]] int in_view(const MapFromCamera& pose) const;
  // Region of interest: the box about the tags with a margin; nothing where that is most of the
  // image.
  [[nodiscard]] std::optional<PixelBox> box_about(const MapFromCamera& pose) const;
  // Mean distance between two poses' images of the corners of the verified tags [px].
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
  // Aligns without these tags; does not change `result`. Sets input.rejected, also for later runs.
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
