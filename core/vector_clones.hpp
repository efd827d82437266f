// PENUMBRA_VECTOR_CLONES also compiles a function for AVX2; the loader selects the version for the
// CPU. Both versions give the same bits (-ffp-contract=off). Disabled under sanitizers, because the
// loader calls the selection before they are initialised.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define PENUMBRA_VECTOR_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define PENUMBRA_VECTOR_CLONES
#endif
