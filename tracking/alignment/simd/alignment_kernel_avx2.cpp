// The alignment's inner loops for x86-64-v3 (built with that -march; chosen at run time).
#if defined(__x86_64__)
#define PENUMBRA_KERNEL avx2
#define PENUMBRA_KERNEL_NAME "x86-64-v3"
#include "tracking/alignment/simd/alignment_kernel_body.hpp"
#endif
