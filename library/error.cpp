#include <penumbra/error.hpp>
#include <penumbra/version.hpp>

#include "library/support.hpp"

namespace penumbra {

static_assert(PENUMBRA_VERSION_MAJOR == PENUMBRA_PROJECT_MAJOR &&
                  PENUMBRA_VERSION_MINOR == PENUMBRA_PROJECT_MINOR &&
                  PENUMBRA_VERSION_PATCH == PENUMBRA_PROJECT_PATCH,
              "include/penumbra/version.hpp and CMakeLists.txt have different versions");

Exception::Exception(const std::string& message) : std::runtime_error(message) {}
Exception::Exception(const Exception&) noexcept = default;
Exception::~Exception() = default;

std::string library_version() {
  return fmt::format("{}.{}.{}", PENUMBRA_VERSION_MAJOR, PENUMBRA_VERSION_MINOR,
                     PENUMBRA_VERSION_PATCH);
}

}  // namespace penumbra
