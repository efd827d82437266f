// The alignment's inner loops for x86-64-v3 (built with that -march; selected at run time).
#if defined(__x86_64__)
#define PENUMBRA_SIMD avx2
#define PENUMBRA_SIMD_NAME "x86-64-v3"
#include "tracking/alignment/simd/loops_body.hpp"
#endif
