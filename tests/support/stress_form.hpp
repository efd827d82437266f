// How much a stress test does.
#pragma once

#include <cstdlib>
#include <string>

namespace penumbra::test {

// PENUMBRA_STRESS=long asks for hours in place of minutes.
inline bool long_form() {
  const char* form = std::getenv("PENUMBRA_STRESS");
  return form != nullptr && std::string(form) == "long";
}

// Instrumented code takes some ten times as long: what is counted in runs does fewer of them there,
// on the same code.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

}  // namespace penumbra::test
