#include "render/gl/shader.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <glm/gtc/type_ptr.hpp>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

std::string preamble(GlApi api, std::span<const std::string_view> defines) {
  std::string text = api == GlApi::gl33 ? "#version 330 core\n"
                                        : "#version 300 es\n"
                                          "precision highp float;\n"
                                          "precision highp int;\n"
                                          "precision highp sampler2D;\n"
                                          "precision highp sampler2DArray;\n";
  for (const std::string_view name : defines) text += fmt::format("#define {}\n", name);
  return text;
}

// The first line of file i has number i * kLinesPerFile + 1. `#line`'s file number is not used,
// because Mesa always reports 0.
constexpr std::size_t kLinesPerFile = 100'000;

// Replaces "0:LINE" or "0(LINE)" in a compiler's log by the file's name and the line in that file.
std::string with_file_names(std::string_view log, std::span<const ShaderText> files) {
  std::string named;
  while (!log.empty()) {
    const std::size_t end = std::min(log.find('\n'), log.size());
    const std::string_view line = log.substr(0, end);
    log.remove_prefix(std::min(end + 1, log.size()));
    if (!named.empty() && !line.empty()) named += " | ";
    const char* const last = line.data() + line.size();
    const char* first = line.data() + (line.starts_with("ERROR: ") ? 7 : 0);
    std::size_t string_number = 0;
    std::size_t line_number = 0;
    const auto string_result = std::from_chars(first, last, string_number);
    if (string_result.ec == std::errc() && string_result.ptr != last &&
        (*string_result.ptr == ':' || *string_result.ptr == '(')) {
      const auto line_result = std::from_chars(string_result.ptr + 1, last, line_number);
      if (line_result.ec == std::errc() && line_number / kLinesPerFile < files.size()) {
        named += fmt::format("{}:{}{}", files[line_number / kLinesPerFile].name,
                             line_number % kLinesPerFile, std::string_view(line_result.ptr, last));
        continue;
      }
    }
    named += line;
  }
  return named;
}

Result<ShaderHandle> compile(GlApi api, unsigned stage, std::span<const ShaderText> files,
                             std::span<const std::string_view> defines) {
  std::string text = preamble(api, defines);
  for (std::size_t i = 0; i < files.size(); ++i) {
    text += fmt::format("#line {}\n", i * kLinesPerFile + 1);
    text += files[i].text;
    text += '\n';
  }
  ShaderHandle shader(glCreateShader(stage));
  const char* bytes = text.c_str();
  glShaderSource(shader.id(), 1, &bytes, nullptr);
  glCompileShader(shader.id());
  GLint ok = GL_FALSE;
  glGetShaderiv(shader.id(), GL_COMPILE_STATUS, &ok);
  if (ok != GL_TRUE) {
    GLint length = 0;
    glGetShaderiv(shader.id(), GL_INFO_LOG_LENGTH, &length);
    std::string log(static_cast<std::size_t>(std::max(length, 1)), '\0');
    GLsizei written = 0;
    glGetShaderInfoLog(shader.id(), length, &written, log.data());
    log.resize(static_cast<std::size_t>(written));
    return fail("shader does not compile: {}", with_file_names(log, files));
  }
  return shader;
}

Result<std::vector<ShaderText>> find_files(const ShaderFiles& names) {
  std::vector<ShaderText> files;
  for (const std::string_view name : names) {
    const auto all = embedded_shaders();
    const auto found = std::ranges::find(all, name, &ShaderText::name);
    if (found == all.end()) return fail("shader {} is not part of this program", name);
    files.push_back(*found);
  }
  return files;
}

}  // namespace

Result<ShaderProgram> ShaderProgram::link(GlApi api, const ShaderFiles& vertex_files,
                                          const ShaderFiles& fragment_files,
                                          std::span<const std::string_view> defines) {
  PENUMBRA_TRY(const auto vertex, find_files(vertex_files));
  PENUMBRA_TRY(const auto fragment, find_files(fragment_files));
  return link_texts(api, vertex, fragment, defines);
}

Result<ShaderProgram> ShaderProgram::link_texts(GlApi api, std::span<const ShaderText> vertex,
                                                std::span<const ShaderText> fragment,
                                                std::span<const std::string_view> defines) {
  PENUMBRA_TRY(const auto vertex_shader, compile(api, GL_VERTEX_SHADER, vertex, defines));
  PENUMBRA_TRY(const auto fragment_shader, compile(api, GL_FRAGMENT_SHADER, fragment, defines));

  ShaderProgram program;
  program.program_ = ProgramHandle::create();
  const GLuint id = program.program_.id();
  glAttachShader(id, vertex_shader.id());
  glAttachShader(id, fragment_shader.id());
  glLinkProgram(id);
  GLint ok = GL_FALSE;
  glGetProgramiv(id, GL_LINK_STATUS, &ok);
  if (ok != GL_TRUE) {
    std::array<char, 2048> log{};
    GLsizei written = 0;
    glGetProgramInfoLog(id, static_cast<GLsizei>(log.size()), &written, log.data());
    return fail("shaders {} and {} do not link: {}", vertex.back().name, fragment.back().name,
                std::string_view(log.data(), static_cast<std::size_t>(written)));
  }
  glDetachShader(id, vertex_shader.id());
  glDetachShader(id, fragment_shader.id());

  GLint count = 0;
  glGetProgramiv(id, GL_ACTIVE_UNIFORMS, &count);
  for (GLint i = 0; i < count; ++i) {
    std::array<char, 128> name{};
    GLsizei length = 0;
    GLint size = 0;
    GLenum type = 0;
    glGetActiveUniform(id, static_cast<GLuint>(i), static_cast<GLsizei>(name.size()), &length,
                       &size, &type, name.data());
    std::string_view plain(name.data(), static_cast<std::size_t>(length));
    plain = plain.substr(0, plain.find('['));  // an array is listed as "values[0]"
    program.uniforms_.emplace_back(std::string(plain), glGetUniformLocation(id, name.data()));
  }
  std::ranges::sort(program.uniforms_);
  return program;
}

void ShaderProgram::use() const {
  glUseProgram(program_.id());
}

int ShaderProgram::location(std::string_view name) const {
  const auto found =
      std::ranges::lower_bound(uniforms_, name, {}, &std::pair<std::string, int>::first);
  return found != uniforms_.end() && found->first == name ? found->second : -1;
}

void ShaderProgram::set(std::string_view name, int value) const {
  glUniform1i(location(name), value);
}
void ShaderProgram::set(std::string_view name, float value) const {
  glUniform1f(location(name), value);
}
void ShaderProgram::set(std::string_view name, const glm::vec2& value) const {
  glUniform2fv(location(name), 1, glm::value_ptr(value));
}
void ShaderProgram::set(std::string_view name, const glm::vec3& value) const {
  glUniform3fv(location(name), 1, glm::value_ptr(value));
}
void ShaderProgram::set(std::string_view name, const glm::vec4& value) const {
  glUniform4fv(location(name), 1, glm::value_ptr(value));
}
void ShaderProgram::set(std::string_view name, const glm::mat3& value) const {
  glUniformMatrix3fv(location(name), 1, GL_FALSE, glm::value_ptr(value));
}
void ShaderProgram::set(std::string_view name, const glm::mat4x3& value) const {
  glUniformMatrix4x3fv(location(name), 1, GL_FALSE, glm::value_ptr(value));
}
void ShaderProgram::set(std::string_view name, std::span<const glm::vec4> values) const {
  if (values.empty()) return;
  glUniform4fv(location(name), static_cast<GLsizei>(values.size()), glm::value_ptr(values[0]));
}

}  // namespace penumbra
