// What the renderer and those who use it include beside the common headers, compiled once each (see
// options.cmake). Nothing includes this file by name.
#pragma once

#include <glm/vec3.hpp>
#include <nlohmann/json.hpp>

#include "cmake/common_headers.hpp"
#include "render/scene/scene.hpp"
