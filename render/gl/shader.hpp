// GLSL files -> a linked program. One body for both APIs: the preamble is the only difference.
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

// A file of render/shaders, as embedded into the program when it was built.
struct EmbeddedShader {
  std::string_view name;  // "lens.glsl"
  std::string_view text;
};
[[nodiscard]] std::span<const EmbeddedShader> embedded_shaders();

// The text of a stage: several files put one behind the other in place of #include.
struct ShaderText {
  std::string_view name;
  std::string_view text;
};

class ShaderProgram {
 public:
  // Files by name; `defines` are put into the preamble, each behind `#define `. An error names the
  // file and the line.
  [[nodiscard]] static Result<ShaderProgram> link(GlApi api,
                                                  std::span<const std::string_view> vertex_files,
                                                  std::span<const std::string_view> fragment_files,
                                                  std::span<const std::string_view> defines = {});
  [[nodiscard]] static Result<ShaderProgram> link_texts(
      GlApi api, std::span<const ShaderText> vertex, std::span<const ShaderText> fragment,
      std::span<const std::string_view> defines = {});

  void use() const;

  // Uniforms of the program in use. A name that the compiler optimised away is passed over.
  void set(std::string_view name, int value) const;
  void set(std::string_view name, float value) const;
  void set(std::string_view name, const glm::vec2& value) const;
  void set(std::string_view name, const glm::vec3& value) const;
  void set(std::string_view name, const glm::vec4& value) const;
  void set(std::string_view name, const glm::mat3& value) const;
  void set(std::string_view name, const glm::mat4x3& value) const;
  void set(std::string_view name, std::span<const glm::vec4> values) const;

 private:
  ShaderProgram() = default;
  [[nodiscard]] int location(std::string_view name) const;

  GlHandle<ProgramTraits> program_;
  std::vector<std::pair<std::string, int>> uniforms_;  // sorted by name
};

}  // namespace penumbra
