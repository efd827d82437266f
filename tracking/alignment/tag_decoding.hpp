// Checks that the data cells at a solved pose read as the expected tags.
#pragma once

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/edge_samples.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {

// Sets the result's tags, tags_verified, verified and reason by the active tags' data cells.
void decode_tags(AlignmentProblem& problem, EdgeSampler& sampler, AlignmentResult& result);

}  // namespace penumbra
