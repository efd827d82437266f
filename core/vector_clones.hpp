// PENUMBRA_VECTOR_CLONES compiles a function for AVX2 as well; the program chooses when it starts.
// Every clone gives the same bits (-ffp-contract=off). No clones under sanitizers, which start
// after the choice.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define PENUMBRA_VECTOR_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define PENUMBRA_VECTOR_CLONES
#endif
