// Sizes of tests: short in every run, long in a nightly campaign.
#pragma once

#include <cstdlib>

namespace penumbra::test {

// PENUMBRA_NIGHTLY in the environment selects the long form; tests with the nightly label set it.
inline bool nightly() {
  return std::getenv("PENUMBRA_NIGHTLY") != nullptr;
}

// Instrumented code is about ten times slower, so tests that repeat runs use fewer repetitions.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

}  // namespace penumbra::test
