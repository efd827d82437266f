// Reads back the positions that the vertex shader computes (by transform feedback) and compares
// them with exact layer factors. The shader uses other formulas than the CPU.
#include <epoxy/gl.h>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <limits>
#include <memory>
#include <random>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "render/gl/buffer.hpp"
#include "render/gl/context.hpp"
#include "render/gl/shader.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "support/json_file.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

struct Vertex {
  glm::vec3 position{0.0F}, kernel{0.0F};
};

// Runs shadow.vert.glsl with a lens function that outputs the position on the plane.
class PositionReader {
 public:
  explicit PositionReader(GlApi api) {
    auto context = create_offscreen_context(api);
    if (!context) throw std::runtime_error(context.error().message);
    context_ = std::move(*context);
    context_->make_current();
    const auto shaders = embedded_shaders();
    const auto source = std::ranges::find(shaders, "shadow.vert.glsl", &ShaderText::name);
    if (source == shaders.end()) throw std::runtime_error("no shadow.vert.glsl");
    const std::string version = api == GlApi::gl33 ? "#version 330 core\n"
                                                   : "#version 300 es\nprecision highp float;\n"
                                                     "precision highp int;\n";
    program_ = glCreateProgram();
    attach(GL_VERTEX_SHADER, version +
                                 "vec4 shadow_clip(mat4x3 camera_from_plane, vec2 place) {\n"
                                 "  vec3 p = camera_from_plane * vec4(place, 0.0, 1.0);\n"
                                 "  return vec4(p.xy, 0.0, 1.0);\n}\n" +
                                 std::string(source->text));
    attach(GL_FRAGMENT_SHADER, version +
                                   "flat in float light_left;\nout vec4 color;\n"
                                   "void main() { color = vec4(light_left); }\n");
    const char* const varying = "gl_Position";
    glTransformFeedbackVaryings(program_, 1, &varying, GL_INTERLEAVED_ATTRIBS);
    glLinkProgram(program_);
    GLint linked = GL_FALSE;
    glGetProgramiv(program_, GL_LINK_STATUS, &linked);
    if (linked != GL_TRUE) throw std::runtime_error("the program does not link");
    array_ = std::make_unique<VertexArray>();
    input_ = std::make_unique<GlBuffer>(BufferUse::vertices);
    glGenBuffers(1, &output_);
    // OpenGL requires a framebuffer for draw calls, although nothing is rasterised.
    glGenFramebuffers(1, &framebuffer_);
    glGenRenderbuffers(1, &pixel_);
    glBindRenderbuffer(GL_RENDERBUFFER, pixel_);
    glRenderbufferStorage(GL_RENDERBUFFER, GL_RGBA8, 1, 1);
    glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER, pixel_);
  }
  PositionReader(const PositionReader&) = delete;
  PositionReader& operator=(const PositionReader&) = delete;
  ~PositionReader() {
    glDeleteFramebuffers(1, &framebuffer_);
    glDeleteRenderbuffers(1, &pixel_);
    glDeleteBuffers(1, &output_);
    glDeleteProgram(program_);
  }

  // Returns the positions of one layer's vertices. Sets the uniforms as ShadowPass does.
  std::vector<glm::vec2> places(const LayeredConstants& c, ShadowLayer layer,
                                std::span<const Vertex> vertices) {
    glUseProgram(program_);
    const auto set = [this](const char* name, double value) {
      glUniform1f(glGetUniformLocation(program_, name), static_cast<float>(value));
    };
    set("inverse_light_height", 1.0 / c.light_height);
    set("umbra_height", c.umbra_height);
    set("inverse_umbra_height", 1.0 / c.umbra_height);
    set("height_cap", std::min(layer_height_range(c, ShadowLayer::middle).high, 1e30));
    glUniform3f(glGetUniformLocation(program_, "layer_light"), 0.2F, 0.4F, 0.6F);
    glUniform1i(glGetUniformLocation(program_, "first_layer"), static_cast<int>(layer));
    const float identity[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
    for (const char* const name : {"plane_from_caster", "camera_from_plane"})
      glUniformMatrix4x3fv(glGetUniformLocation(program_, name), 1, GL_FALSE, identity);
    array_->bind();
    input_->write(vertices, BufferLife::every_frame);
    VertexArray::attribute(0, 3, sizeof(Vertex), 0);
    VertexArray::attribute(1, 3, sizeof(Vertex), sizeof(glm::vec3));
    std::vector<glm::vec4> read(vertices.size());
    const auto bytes = static_cast<GLsizeiptr>(read.size() * sizeof(glm::vec4));
    glBindBufferBase(GL_TRANSFORM_FEEDBACK_BUFFER, 0, output_);
    glBufferData(GL_TRANSFORM_FEEDBACK_BUFFER, bytes, nullptr, GL_STREAM_READ);
    glEnable(GL_RASTERIZER_DISCARD);
    glBeginTransformFeedback(GL_POINTS);
    glDrawArraysInstanced(GL_POINTS, 0, static_cast<GLsizei>(vertices.size()), 1);
    glEndTransformFeedback();
    glDisable(GL_RASTERIZER_DISCARD);
    const void* const mapped =
        glMapBufferRange(GL_TRANSFORM_FEEDBACK_BUFFER, 0, bytes, GL_MAP_READ_BIT);
    EXPECT_NE(mapped, nullptr);
    if (mapped != nullptr) {
      const auto* const from = static_cast<const glm::vec4*>(mapped);
      std::copy(from, from + read.size(), read.begin());
      glUnmapBuffer(GL_TRANSFORM_FEEDBACK_BUFFER);
    }
    EXPECT_EQ(glGetError(), static_cast<GLenum>(GL_NO_ERROR));
    std::vector<glm::vec2> result;
    for (const glm::vec4& p : read) result.emplace_back(p.x, p.y);
    return result;
  }

 private:
  void attach(GLenum stage, const std::string& text) const {
    const GLuint shader = glCreateShader(stage);
    const char* const source = text.c_str();
    glShaderSource(shader, 1, &source, nullptr);
    glCompileShader(shader);
    GLint compiled = GL_FALSE;
    glGetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
    if (compiled != GL_TRUE) throw std::runtime_error("a shader does not compile");
    glAttachShader(program_, shader);
    glDeleteShader(shader);
  }

  std::unique_ptr<GlContext> context_;
  std::unique_ptr<VertexArray> array_;
  std::unique_ptr<GlBuffer> input_;
  GLuint program_ = 0;
  GLuint output_ = 0;
  GLuint framebuffer_ = 0;
  GLuint pixel_ = 0;
};

class ShadowShader : public testing::TestWithParam<GlApi> {};

// Returns the error bound of a projected vertex that is 1 m from its kernel. The distance of its
// projection from the kernel equals the layer's factor s. H: height of the light, h: height of the
// vertex [m] (docs/shadows.md#layers: error within 4e-7 (1 + |s|) H / (H - h)).
double bound_of(double exact, double H, double h) {
  return 4e-7 * (1.0 + std::abs(exact)) * (std::isinf(H) ? 1.0 : H / (H - h));
}

TEST_P(ShadowShader, MatchesReferenceFactorsWithinFloatBound) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  PositionReader reader(GetParam());
  const nlohmann::json json = test::read_json(test::shared_dir() / "vectors" / "factors.json");
  ASSERT_GT(json.at("cases").size(), 0U);
  for (const auto& entry : json.at("cases")) {
    const double H = entry.at("H").get<double>();
    const double h = entry.at("h").get<double>();
    const LayeredConstants constants =
        make_layered_constants(H, entry.at("a").get<double>(), 0.0).value();
    const std::vector<Vertex> vertex = {{{1.0F, 0.0F, static_cast<float>(h)}, {}}};
    for (const auto& [layer, key] :
         {std::pair{ShadowLayer::umbra, "umbra"}, std::pair{ShadowLayer::middle, "middle"},
          std::pair{ShadowLayer::penumbra, "penumbra"}}) {
      const bool gone = layer == ShadowLayer::umbra && !entry.at("umbra_visible").get<bool>();
      const double exact = gone ? 0.0 : entry.at(key).get<double>();
      const glm::vec2 place = reader.places(constants, layer, vertex)[0];
      EXPECT_NEAR(place.x, exact, bound_of(exact, H, h)) << key << ", H " << H << ", h " << h;
      EXPECT_EQ(place.y, 0.0F);
    }
  }
}

// Computes exact factors in long double for lights that are near, far and at the zenith. The
// heights are in each layer's range and close to its lower and upper end.
TEST_P(ShadowShader, MatchesExactFactorsWithinFloatBound) {
  PositionReader reader(GetParam());
  std::mt19937 random(11);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  const auto in_float = [](double value) { return static_cast<double>(static_cast<float>(value)); };
  double worst = 0.0;  // largest error as a fraction of the bound
  for (int set = 0; set < 200; ++set) {
    const bool zenith = set % 5 == 0;
    const double H = zenith ? std::numeric_limits<double>::infinity()
                            : in_float(std::pow(10.0, -1.0 + 2.0 * unit(random)));
    const double a = zenith ? 0.0 : in_float(0.3 + 7.7 * unit(random));
    const double h_u = zenith ? in_float(0.05 + unit(random)) : 0.0;
    const LayeredConstants constants = make_layered_constants(H, a, h_u).value();
    for (const ShadowLayer layer : kShadowLayers) {
      const double high = std::min(layer_height_range(constants, layer).high, 3.0);
      std::vector<Vertex> vertices;
      for (int i = 0; i < 60; ++i) {
        const double where = unit(random);
        const double height = i % 3 == 0   ? where * high
                              : i % 3 == 1 ? high * (1.0 - 1e-6 * where)
                                           : high * 1e-6 * where;
        const auto h = static_cast<float>(height);
        if (static_cast<double>(h) > high) continue;  // rounded beyond the end of the range
        vertices.push_back({{1.0F, 0.0F, h}, {}});
      }
      const auto places = reader.places(constants, layer, vertices);
      for (std::size_t i = 0; i < vertices.size(); ++i) {
        const auto h = static_cast<long double>(vertices[i].position.z);
        const auto lambda = static_cast<long double>(lambda_of(layer));
        const long double exact =
            zenith ? 1.0L + lambda * h / static_cast<long double>(h_u)
                   : (static_cast<long double>(H) + lambda * static_cast<long double>(a) * h) /
                         (static_cast<long double>(H) - h);
        const auto value = static_cast<double>(exact);
        const double bound = bound_of(value, H, static_cast<double>(h));
        const double off = std::abs(static_cast<double>(places[i].x) - value);
        worst = std::max(worst, off / bound);
        ASSERT_LE(off, bound) << "H " << H << ", a " << a << ", h " << vertices[i].position.z
                              << ", lambda " << lambda_of(layer);
      }
    }
  }
  EXPECT_GT(worst, 0.01) << "float rounding must show in the comparison";
  RecordProperty("worst_share_of_the_bound", fmt::format("{:.3f}", worst));
}

// At the plane, the middle layer and the penumbra equal the vertex exactly, and the umbra equals it
// up to rounding. At the umbra height, the umbra equals the kernel exactly.
TEST_P(ShadowShader, IsExactAtContactAndUmbraHeight) {
  PositionReader reader(GetParam());
  const double inf = std::numeric_limits<double>::infinity();
  for (const LayeredConstants& constants : {make_layered_constants(0.9, 3.0, 0.0).value(),
                                            make_layered_constants(1.1, 1.7, 0.0).value(),
                                            make_layered_constants(inf, 0.0, 0.3).value()}) {
    const std::vector<Vertex> vertices = {
        {{0.31F, -0.17F, 0.0F}, {0.1F, 0.07F, 0.3F}},
        {{0.31F, -0.17F, static_cast<float>(constants.umbra_height)}, {0.1F, 0.07F, 0.3F}}};
    for (const ShadowLayer layer : {ShadowLayer::middle, ShadowLayer::penumbra}) {
      const glm::vec2 place = reader.places(constants, layer, vertices)[0];
      EXPECT_EQ(place, glm::vec2(0.31F, -0.17F)) << lambda_of(layer);
    }
    const auto umbra = reader.places(constants, ShadowLayer::umbra, vertices);
    EXPECT_NEAR(umbra[0].x, 0.31F, 6e-8F);  // the umbra is anchored at its kernel
    EXPECT_NEAR(umbra[0].y, -0.17F, 6e-8F);
    EXPECT_EQ(umbra[1], glm::vec2(0.1F, 0.07F));
  }
}

INSTANTIATE_TEST_SUITE_P(Apis, ShadowShader, testing::Values(GlApi::gl33, GlApi::gles30),
                         [](const auto& param_info) {
                           return param_info.param == GlApi::gl33 ? "gl33" : "gles30";
                         });

}  // namespace
}  // namespace penumbra
