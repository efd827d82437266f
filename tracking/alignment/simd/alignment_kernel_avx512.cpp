// The alignment's inner loops for x86-64-v4 (built with that -march; chosen at run time).
#if defined(__x86_64__)
#define PENUMBRA_KERNEL avx512
#define PENUMBRA_KERNEL_NAME "x86-64-v4"
#include "tracking/alignment/simd/alignment_kernel_body.hpp"
#endif
