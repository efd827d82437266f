// Links a program from GLSL files. Both APIs compile the same text with different preambles.
#pragma once

#include <glm/mat3x3.hpp>
#include <glm/mat4x3.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/error.hpp"
#include "render/gl/context.hpp"
#include "render/gl/handle.hpp"

namespace penumbra {

struct ShaderText {
  std::string_view name;  // "lens.glsl"
  std::string_view text;
};
// The files of render/shaders, embedded at build time.
[[nodiscard]] std::span<const ShaderText> embedded_shaders();

using ShaderFiles = std::vector<std::string_view>;  // names; a stage is their concatenation

class ShaderProgram {
 public:
  ShaderProgram() = default;  // no program
  // `defines`: text after `#define `. Compiler errors report the file and the line.
  [[nodiscard]] static Result<ShaderProgram> link(GlApi api, const ShaderFiles& vertex,
                                                  const ShaderFiles& fragment,
                                                  std::span<const std::string_view> defines = {});
  [[nodiscard]] static Result<ShaderProgram> link_texts(
      GlApi api, std::span<const ShaderText> vertex, std::span<const ShaderText> fragment,
      std::span<const std::string_view> defines = {});

  void use() const;

  // Sets a uniform of the program in use; ignores names that the program does not use.
  void set(std::string_view name, int value) const;
  void set(std::string_view name, float value) const;
  void set(std::string_view name, const glm::vec2& value) const;
  void set(std::string_view name, const glm::vec3& value) const;
  void set(std::string_view name, const glm::vec4& value) const;
  void set(std::string_view name, const glm::mat3& value) const;
  void set(std::string_view name, const glm::mat4x3& value) const;
  void set(std::string_view name, std::span<const glm::vec4> values) const;

 private:
  [[nodiscard]] int location(std::string_view name) const;

  ProgramHandle program_;
  std::vector<std::pair<std::string, int>> uniforms_;  // sorted by name
};

}  // namespace penumbra
