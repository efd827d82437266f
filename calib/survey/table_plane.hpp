// The plane of the tags that lie on the table: z = 0 of a surveyed map.
#pragma once

#include <map>
#include <vector>

#include "calib/survey/tag_graph.hpp"
#include "calib/survey/tag_survey.hpp"

namespace penumbra {

// Returns the ids of tags coplanar with the anchor and with the same normal. Starts from tags near
// the anchor's plane, then repeats with the plane fitted to the tags found. `tags`: T_anchor_tag by
// id. Returns the anchor alone if SurveyOptions::plane asks for it, or if fewer than three tags
// that are not collinear are found.
[[nodiscard]] std::vector<int> tags_on_table(const std::map<int, TagPose>& tags,
                                             const SurveyOptions& options);

// Transforms tags, cameras and covariance from the anchor's frame to the table's. `tags`:
// T_anchor_tag of survey.tags. `on_plane`: ids of the tags on the table.
void transform_to_plane(TagSurvey& survey, const std::map<int, TagPose>& tags,
                        const GraphCovariance& found, const std::vector<int>& on_plane, int anchor);

}  // namespace penumbra
