// Checks that the data cells at a solved pose read as the expected tags.
#pragma once

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/edge_samples.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {

// Reads the data cells of the active tags. Fills in the result's tags, tags_verified, verified and,
// where it is not, the reason.
void decode_tags(AlignmentProblem& problem, EdgeSampler& sampler, AlignmentResult& result);

}  // namespace penumbra
