// Correlation of residuals along an edge.
#pragma once

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/pose_solver.hpp"
#include "tracking/alignment/sample_arena.hpp"

namespace penumbra {

// The design effect: how many times larger the variance of an edge's mean displacement is than
// independent residuals would make it. `cutoff`: as the last step had it. See
// docs/tracking.md#design-effect.
[[nodiscard]] double design_effect(const AlignmentProblem& problem, const PoseSolver& solver,
                                   SampleArena& arena, double cutoff);

}  // namespace penumbra
