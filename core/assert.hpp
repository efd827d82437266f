// PENUMBRA_ASSERT stops at a broken precondition of the program, never of its input, in every
// build: a wrong overlay is worse than a stop. Not for inner loops.
#pragma once

#include <cstdio>
#include <cstdlib>

#define PENUMBRA_ASSERT(condition)                                                            \
  do {                                                                                        \
    if (!(condition)) [[unlikely]] {                                                          \
      std::fprintf(stderr, "%s:%d: broken assumption: %s\n", __FILE__, __LINE__, #condition); \
      std::abort();                                                                           \
    }                                                                                         \
  } while (false)
