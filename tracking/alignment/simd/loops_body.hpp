// The body of alignment_loops.hpp, included by one .cpp file per instruction set: PENUMBRA_SIMD
// names its namespace. A file that is compiled for a wider instruction set must not instantiate
// templates that other files share, so only builtins and plain arrays are used here.
#include "tracking/alignment/simd/alignment_loops.hpp"

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#define PENUMBRA_INLINE inline __attribute__((always_inline))

namespace penumbra::simd::PENUMBRA_SIMD {
namespace {

// Each of these uses what is above it.
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
                      marginalise,
                      follow,
                      evaluate,
                      evaluate_moments,
                      leverage,
                      search,
                      add,
                      cell_places};

}  // namespace penumbra::simd::PENUMBRA_SIMD

#undef PENUMBRA_INLINE
