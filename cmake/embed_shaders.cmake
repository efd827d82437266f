# cmake -D OUTPUT=FILE.cpp -D FOLDER=DIR -D NAMES="a.glsl b.glsl" -P embed_shaders.cmake
# Writes shader files as string literals into one source file. The program knows them by file name, so no path of the build
# machine gets into it.
separate_arguments(NAMES)
set(entries "")
foreach(name IN LISTS NAMES)
  file(READ "${FOLDER}/${name}" text)
  string(APPEND entries "    ShaderText{\"${name}\", R\"glsl(${text})glsl\"},\n")
endforeach()
file(CONFIGURE OUTPUT "${OUTPUT}" @ONLY CONTENT [=[
// Written by cmake/embed_shaders.cmake from render/shaders.
#include <array>

#include "render/gl/shader.hpp"

namespace penumbra {
namespace {

constexpr std::array kShaders = {
@entries@};

}  // namespace

std::span<const ShaderText> embedded_shaders() {
  return kShaders;
}

}  // namespace penumbra
]=])
