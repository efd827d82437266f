// Precompiled headers of the renderer and its users, in addition to the common headers (see
// options.cmake). Nothing includes this file by name.
#pragma once

#include <glm/vec3.hpp>
#include <nlohmann/json.hpp>

#include "cmake/common_headers.hpp"
#include "render/scene/scene.hpp"
