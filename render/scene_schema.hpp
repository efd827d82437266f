// The published JSON Schema of scenes, as it was when the program was built.
#pragma once

#include <string_view>

namespace penumbra {

[[nodiscard]] std::string_view scene_schema();

}  // namespace penumbra
