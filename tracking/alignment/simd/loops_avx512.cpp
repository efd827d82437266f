// The alignment's inner loops for x86-64-v4 (built with that -march; chosen at run time).
#if defined(__x86_64__)
#define PENUMBRA_SIMD avx512
#define PENUMBRA_SIMD_NAME "x86-64-v4"
#include "tracking/alignment/simd/loops_body.hpp"
#endif
