// PENUMBRA_ASSERT: a broken precondition of this program, never of its input. On in every build:
// the checks stand outside inner loops, and a wrong overlay is worse than a stop.
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
