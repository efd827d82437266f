// Defines the loops of alignment_loops.hpp in the namespace PENUMBRA_SIMD; included once for each
// instruction set. Uses only builtins and plain arrays, as explained in that header.
#include "tracking/alignment/simd/alignment_loops.hpp"

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#define PENUMBRA_INLINE inline __attribute__((always_inline))

namespace penumbra::simd::PENUMBRA_SIMD {
namespace {

// Each file uses the preceding ones.
// clang-format off
#include "tracking/alignment/simd/wide_body.hpp"
#include "tracking/alignment/simd/projection_body.hpp"
#include "tracking/alignment/simd/edge_walk_body.hpp"
#include "tracking/alignment/simd/sampling_body.hpp"
#include "tracking/alignment/simd/residuals_body.hpp"
#include "tracking/alignment/simd/marginalisation_body.hpp"
#include "tracking/alignment/simd/search_body.hpp"
// clang-format on

}  // namespace

extern const Loops kLoops;
const Loops kLoops = {PENUMBRA_SIMD_NAME,
                      project,
                      walk,
                      measure_runs,
                      walk_runs,
                      read,
                      prepare,
                      attach,
                      accumulate,
                      anchor,
                      flatten,
                      marginalise,
                      follow,
                      evaluate,
                      leverage,
                      search,
                      add,
                      cell_pixels};

}  // namespace penumbra::simd::PENUMBRA_SIMD

#undef PENUMBRA_INLINE
