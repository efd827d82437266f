// The alignment's inner loops for any processor.
#define PENUMBRA_KERNEL generic
#define PENUMBRA_KERNEL_NAME "generic"
#include "tracking/alignment/simd/alignment_kernel_body.hpp"
