// The published JSON Schema of scenes, as it was when the program was built.
#pragma once

#include <span>
#include <string_view>

namespace penumbra {

[[nodiscard]] std::string_view scene_schema();

// The keywords for whose violation a place and a remedy can be named. The schema uses no others but
// for those that only describe it.
[[nodiscard]] std::span<const std::string_view> schema_keywords();

}  // namespace penumbra
