// PENUMBRA_ASSERT aborts on a programming error, in every build: a wrong overlay is worse than an
// abort. Invalid input is an Error instead. Not for inner loops.
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
