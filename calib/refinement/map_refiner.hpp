// Refines a tag map from keyframes of a tracked session (docs/tracking.md#refining-the-map).
#pragma once

#include <stop_token>
#include <vector>

#include "calib/refinement/keyframes.hpp"
#include "calib/survey/tag_survey.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

struct MapsToRefine {
  TagMap given;    // defines the table frame
  TagMap current;  // the given map, or a refined one
};

// Surveys the table's tags in the keyframes and returns the current map with their new poses and
// curvatures. Refines the family with the most tags; sizes and other groups stay. The refined tags
// are aligned to the given ones, so the table frame stays. The error is one line: why the current
// map is to be kept. The same input gives the same bits. Once `stop` is requested, fails soon.
[[nodiscard]] Result<TagMap> refine_map(const CameraModel& camera, const MapsToRefine& maps,
                                        const KeyframeList& keyframes, std::stop_token stop);

struct RefinedLens {
  TagMap map;        // belongs to the lens
  TagSurvey survey;  // has the lens; in the frame of one of its tags
};

// Like refine_map(), but solves for the lens as well. `lens_sigmas`: as in SurveyOptions. The error
// is why the given lens is to be kept.
[[nodiscard]] Result<RefinedLens> refine_lens(const CameraModel& camera, const MapsToRefine& maps,
                                              const KeyframeList& keyframes,
                                              const std::vector<double>& lens_sigmas,
                                              std::stop_token stop);

// Distances of the corners of the table's tags from where another map has them [m].
struct MapChange {
  double rms_m = 0.0;
  double max_m = 0.0;
};
// Both maps must have the same tags in the same order.
[[nodiscard]] MapChange change_of_map(const TagMap& before, const TagMap& after);

}  // namespace penumbra
