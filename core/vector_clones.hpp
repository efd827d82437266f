// PENUMBRA_VECTOR_CLONES: compiles a function for the machine's wider vectors as well, chosen when
// the program starts. Sums and products are rounded one by one (-ffp-contract=off), so every clone
// gives the same bits. Plain under sanitizers, whose start-up comes after the choice.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define PENUMBRA_VECTOR_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define PENUMBRA_VECTOR_CLONES
#endif
