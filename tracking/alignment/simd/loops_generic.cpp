// The alignment's inner loops for any processor.
#define PENUMBRA_SIMD generic
#define PENUMBRA_SIMD_NAME "generic"
#include "tracking/alignment/simd/loops_body.hpp"
