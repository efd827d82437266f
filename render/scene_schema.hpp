// The published JSON Schema of scenes (scenes/scene.schema.json), embedded into the program.
#pragma once

#include <string_view>

namespace penumbra {

[[nodiscard]] std::string_view scene_schema();

}  // namespace penumbra
