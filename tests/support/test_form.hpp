// How much a test does: little in every run, all of it in a nightly campaign.
#pragma once

#include <cstdlib>

namespace penumbra::test {

// PENUMBRA_NIGHTLY in the environment asks for the long form; the tests of the nightly label set
// it.
inline bool nightly() {
  return std::getenv("PENUMBRA_NIGHTLY") != nullptr;
}

// Instrumented code takes some ten times as long: tests that repeat runs do fewer of them.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

}  // namespace penumbra::test
