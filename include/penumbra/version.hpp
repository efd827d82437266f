// Version of the library. Programs built for another 0.x version must be built again
// (docs/library.md#versions).
#pragma once

#include <penumbra/api.hpp>
#include <string>

// Version of these headers.
#define PENUMBRA_VERSION_MAJOR 0
#define PENUMBRA_VERSION_MINOR 1
#define PENUMBRA_VERSION_PATCH 0

namespace penumbra {

// Returns the version of the library that the program runs with: "0.1.0".
[[nodiscard]] PENUMBRA_API std::string library_version();

}  // namespace penumbra
