#include "soft_shadows.hpp"

#include <fmt/format.h>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "core/text/text.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra::counted {
namespace {

constexpr int kMapSide = 512;  // texels; similar to the shadow's size in pixels
constexpr int kSumUnit = 0, kHeightUnit = 0, kBlockedUnit = 1;
constexpr int kMaxSums = 255;  // maximum value of the stencil

// Projects a caster's vertex from a point of the light into the map or the image.
constexpr std::string_view kCasterVertex = R"(
layout(location = 0) in vec3 position;
uniform mat4x3 plane_from_caster;  // -> (u, v, h)
uniform vec2 towards_light;        // slopes: (u, v) over h
uniform vec4 bounds;
uniform float top;
uniform mat4x3 camera_from_plane;
void main() {
  vec3 x = plane_from_caster * vec4(position, 1.0);
  vec2 on_plane = x.xy - towards_light * x.z;
#ifdef IN_PICTURE
  gl_Position = lens_clip(camera_from_plane * vec4(on_plane, 0.0, 1.0), 1.001);
#else
  // Depth 1 on the plane, 0 at the top.
  gl_Position = vec4(2.0 * (on_plane - bounds.xy) / bounds.zw - 1.0, 1.0 - 2.0 * x.z / top, 1.0);
#endif
}
)";
constexpr std::string_view kCasterFragment = R"(
layout(location = 0) out vec4 color;
uniform float value;
void main() { color = vec4(value); }
)";
constexpr std::string_view kRectangleVertex = R"(
layout(location = 0) in vec2 corner;  // 0 .. 1
uniform vec4 bounds;
uniform mat4x3 camera_from_plane;
out vec2 at;
void main() {
  at = corner;
  gl_Position = lens_clip(camera_from_plane * vec4(bounds.xy + corner * bounds.zw, 0.0, 1.0),
                          1.001);
}
)";
constexpr std::string_view kRectangleFragment = R"(
in vec2 at;
uniform float ambient;
layout(location = 0) out vec4 color;
#if defined(SUMMED)
uniform sampler2D sum;
uniform float whole;  // sum of a fully blocked light
float blocked() {
#ifdef IN_PICTURE
  return texelFetch(sum, ivec2(gl_FragCoord.xy), 0).r / whole;
#else
  return texture(sum, at).r / whole;
#endif
}
#else
uniform highp sampler2D heights;  // depth: 1 on the plane, 0 at height `top`
uniform highp sampler2DShadow stops;
uniform vec2 radius;  // light's radius, projected onto the plane from height `top`, in map extents
const float kEmpty = 0.9999;
#if defined(PCSS)
// Points spread evenly over a disc on a spiral (Vogel, 1979). Each is rotated by the golden angle
// relative to the previous one.
const mat2 kTurn = mat2(-0.73736888, 0.67549029, -0.67549029, -0.73736888);
float blocked() {
  float depths = 0.0;
  float found = 0.0;
  vec2 towards = vec2(1.0, 0.0);
  for (int i = 0; i < SAMPLES; ++i) {
    vec2 tap = towards * sqrt((float(i) + 0.5) / float(SAMPLES));
    float depth = textureLod(heights, at + tap * radius, 0.0).r;
    if (depth < kEmpty) {
      depths += depth;
      found += 1.0;
    }
    towards = kTurn * towards;
  }
  vec2 width = radius * (1.0 - depths / max(found, 1.0));
  int taps = found > 0.0 ? SAMPLES : 0;  // without a blocker, the filter is not needed
  float sum = 0.0;
  towards = vec2(1.0, 0.0);
  for (int i = 0; i < taps; ++i) {
    vec2 tap = towards * sqrt((float(i) + 0.5) / float(SAMPLES));
    sum += textureLod(stops, vec3(at + tap * width, kEmpty), 0.0);
    towards = kTurn * towards;
  }
  return taps > 0 ? 1.0 - sum / float(SAMPLES) : 0.0;
}
#elif defined(PCF)
float blocked() {
  vec2 texel = 1.0 / vec2(textureSize(heights, 0));
  float sum = 0.0;
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 4; ++x)
      sum += textureLod(stops, vec3(at + (vec2(float(x), float(y)) - 1.5) * texel, kEmpty), 0.0);
  return 1.0 - sum / 16.0;
}
#else
float blocked() { return textureLod(heights, at, 0.0).r < kEmpty ? 1.0 : 0.0; }
#endif
#endif
void main() {
  float light = ambient + (1.0 - ambient) * (1.0 - blocked());
  color = vec4(vec3(pow(light, 1.0 / 2.2)), 1.0);
}
)";

bool summed(SoftTechnique::Kind kind) {
  return kind == SoftTechnique::Kind::average || kind == SoftTechnique::Kind::reference;
}

Result<ShaderProgram> link(std::string_view vertex, std::string_view fragment,
                           std::span<const std::string_view> defines) {
  const auto lens = std::ranges::find(embedded_shaders(), "lens.glsl", &ShaderText::name);
  const std::array vertex_files = {ShaderText{lens->name, lens->text},
                                   ShaderText{"soft shadow", vertex}};
  const std::array fragment_files = {ShaderText{"soft shadow", fragment}};
  return ShaderProgram::link_texts(GlApi::gl33, vertex_files, fragment_files, defines);
}

// Volume of a closed body; negative if its faces are wound inwards.
float volume_of(const ShadowMesh& mesh) {
  float volume = 0.0F;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    const auto corner = [&](std::size_t c) { return mesh.positions[mesh.indices[i + c]]; };
    volume += glm::dot(corner(0), glm::cross(corner(1), corner(2))) / 6.0F;
  }
  return volume;
}

GLuint sampler(GLint filter, bool compared) {
  GLuint id = 0;
  glGenSamplers(1, &id);
  glSamplerParameteri(id, GL_TEXTURE_MIN_FILTER, filter);
  glSamplerParameteri(id, GL_TEXTURE_MAG_FILTER, filter);
  glSamplerParameteri(id, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glSamplerParameteri(id, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  if (compared) {
    glSamplerParameteri(id, GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
    glSamplerParameteri(id, GL_TEXTURE_COMPARE_FUNC, GL_LEQUAL);
  }
  return id;
}

}  // namespace

std::optional<SoftTechnique> soft_technique(std::string_view name) {
  using Kind = SoftTechnique::Kind;
  if (name == "hard-map") return SoftTechnique{Kind::hard, 1};
  if (name == "pcf") return SoftTechnique{Kind::pcf, 16};
  for (const auto& [prefix, kind] : {std::pair{std::string_view("pcss-"), Kind::pcss},
                                     std::pair{std::string_view("average-"), Kind::average},
                                     std::pair{std::string_view("reference-"), Kind::reference}}) {
    if (!name.starts_with(prefix)) continue;
    const auto samples = parse_integer(name.substr(prefix.size()));
    // Sums must be exact: an 8-bit value, or 11 significant bits of a half float.
    const int max_samples = kind == Kind::reference ? 2048 : 255;
    if (!samples || *samples < 1 || *samples > max_samples) return std::nullopt;
    return SoftTechnique{kind, static_cast<int>(*samples)};
  }
  return std::nullopt;
}

Result<SoftShadows> SoftShadows::create(const ShadowMesh& mesh, SoftTechnique technique,
                                        const SoftLight& light, GlContext::Size image) {
  using Kind = SoftTechnique::Kind;
  const bool in_picture = technique.kind == Kind::reference;
  const std::string samples = fmt::format("SAMPLES {}", technique.samples);
  std::vector<std::string_view> defines;
  if (technique.kind == Kind::pcss) defines = {"PCSS", samples};
  if (technique.kind == Kind::pcf) defines = {"PCF"};
  if (summed(technique.kind)) defines = {"SUMMED"};
  if (in_picture) defines.emplace_back("IN_PICTURE");
  auto caster = link(kCasterVertex, kCasterFragment, defines);
  if (!caster) return tl::unexpected(caster.error());
  auto rectangle = link(kRectangleVertex, kRectangleFragment, defines);
  if (!rectangle) return tl::unexpected(rectangle.error());
  SoftShadows soft(std::move(*caster), std::move(*rectangle));
  soft.faces_outwards_ = volume_of(mesh) > 0.0F;
  soft.technique_ = technique;
  soft.light_ = light;
  soft.size_ = in_picture ? image : GlContext::Size{kMapSide, kMapSide};
  soft.positions_ = mesh.positions;
  soft.index_count_ = static_cast<int>(mesh.indices.size());
  soft.mesh_layout_.bind();
  soft.mesh_vertices_.write(std::span<const glm::vec3>(mesh.positions));
  VertexArray::attribute(0, 3, sizeof(glm::vec3), 0);
  soft.mesh_indices_.write(std::span<const std::uint32_t>(mesh.indices));
  soft.rectangle_layout_.bind();
  constexpr std::array<glm::vec2, 4> kCorners = {glm::vec2(0.0F, 0.0F), glm::vec2(1.0F, 0.0F),
                                                 glm::vec2(0.0F, 1.0F), glm::vec2(1.0F, 1.0F)};
  soft.rectangle_vertices_.write(std::span<const glm::vec2>(kCorners));
  VertexArray::attribute(0, 2, sizeof(glm::vec2), 0);

  soft.target_ = FramebufferHandle::create();
  soft.texture_ = TextureHandle::create();
  glBindFramebuffer(GL_FRAMEBUFFER, soft.target_.id());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, soft.texture_.id());
  const auto [width, height] = soft.size_;
  if (summed(technique.kind)) {
    if (in_picture) {
      glTexImage2D(GL_TEXTURE_2D, 0, GL_R16F, width, height, 0, GL_RED, GL_HALF_FLOAT, nullptr);
    } else {
      glTexImage2D(GL_TEXTURE_2D, 0, GL_R8, width, height, 0, GL_RED, GL_UNSIGNED_BYTE, nullptr);
    }
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, soft.texture_.id(),
                           0);
    soft.stencil_ = TextureHandle::create();
    glBindTexture(GL_TEXTURE_2D, soft.stencil_.id());
    glTexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH24_STENCIL8, width, height, 0, GL_DEPTH_STENCIL,
                 GL_UNSIGNED_INT_24_8, nullptr);
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_STENCIL_ATTACHMENT, GL_TEXTURE_2D,
                           soft.stencil_.id(), 0);
  } else {
    glTexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT32F, width, height, 0, GL_DEPTH_COMPONENT,
                 GL_FLOAT, nullptr);
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, soft.texture_.id(),
                           0);
    const GLenum none = GL_NONE;
    glDrawBuffers(1, &none);
    glReadBuffer(GL_NONE);
  }
  if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE)
    return fail("the graphics driver refuses a map of {} x {}", width, height);
  soft.nearest_ = sampler(GL_NEAREST, false);
  soft.compared_ = sampler(GL_LINEAR, !summed(technique.kind));
  return soft;
}

void SoftShadows::set_caster() const {
  caster_.use();
  caster_.set("plane_from_caster", plane_from_caster_);
  caster_.set("bounds", bounds_);
  caster_.set("top", top_);
  mesh_layout_.bind();
  // The shadow of a closed body equals that of its faces towards the light.
  glEnable(GL_CULL_FACE);
  glCullFace(GL_BACK);
  // Row 0 of the image is the top, which flips the winding.
  const bool is_flipped = technique_.kind == SoftTechnique::Kind::reference;
  glFrontFace(is_flipped == faces_outwards_ ? GL_CW : GL_CCW);
}

void SoftShadows::draw_map() {
  glDepthMask(GL_TRUE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glClear(GL_DEPTH_BUFFER_BIT);
  set_caster();
  caster_.set("towards_light", glm::vec2(0.0F));
  glDrawElements(GL_TRIANGLES, index_count_, GL_UNSIGNED_INT, nullptr);
}

void SoftShadows::draw_sum(const LensUniforms& lens, const glm::mat4x3& camera_from_plane) {
  const bool in_picture = technique_.kind == SoftTechnique::Kind::reference;
  glDisable(GL_DEPTH_TEST);
  glEnable(GL_STENCIL_TEST);
  glStencilMask(0xFF);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ONE, GL_ONE);
  glClearColor(0.0F, 0.0F, 0.0F, 0.0F);
  glClear(GL_COLOR_BUFFER_BIT | GL_STENCIL_BUFFER_BIT);
  set_caster();
  if (in_picture) {
    set_lens(caster_, lens);
    caster_.set("camera_from_plane", camera_from_plane);
  }
  caster_.set("value", in_picture ? 1.0F : 1.0F / 255.0F);
  for (int i = 0; i < technique_.samples; ++i) {
    const double r = light_.slope * std::sqrt((i + 0.5) / technique_.samples);
    const double turn = std::numbers::pi * (3.0 - std::sqrt(5.0)) * i;
    caster_.set("towards_light", glm::vec2(static_cast<float>(r * std::cos(turn)),
                                           static_cast<float>(r * std::sin(turn))));
    // The stencil holds the number of the last sample, so that a sample counts a texel once.
    if (i > 0 && i % kMaxSums == 0) glClear(GL_STENCIL_BUFFER_BIT);
    glStencilFunc(GL_NOTEQUAL, i % kMaxSums + 1, 0xFF);
    glDrawElements(GL_TRIANGLES, index_count_, GL_UNSIGNED_INT, nullptr);
  }
  glDisable(GL_BLEND);
  glDisable(GL_STENCIL_TEST);
}

void SoftShadows::prepare(const Placement& T_table_object, const PlaneFrame& plane,
                          const LensUniforms& lens, const glm::mat4x3& camera_from_plane) {
  plane_from_caster_ = plane_from_object(plane, T_table_object);
  glm::vec2 low(std::numeric_limits<float>::infinity());
  glm::vec2 high = -low;
  top_ = 0.0F;
  for (const glm::vec3& p : positions_) {
    const glm::vec3 x = plane_from_caster_ * glm::vec4(p, 1.0F);
    const float radius = static_cast<float>(light_.slope) * x.z;
    low = glm::min(low, glm::vec2(x) - radius);
    high = glm::max(high, glm::vec2(x) + radius);
    top_ = std::max(top_, x.z);
  }
  bounds_ = {low, high - low};
  glBindFramebuffer(GL_FRAMEBUFFER, target_.id());
  glViewport(0, 0, size_.width, size_.height);
  if (summed(technique_.kind)) {
    draw_sum(lens, camera_from_plane);
  } else {
    draw_map();
  }
  glDisable(GL_CULL_FACE);
  glFrontFace(GL_CCW);
}

void SoftShadows::draw(const LensUniforms& lens, const glm::mat4x3& camera_from_plane) const {
  const ShaderProgram& p = rectangle_;
  p.use();
  set_lens(p, lens);
  p.set("camera_from_plane", camera_from_plane);
  p.set("bounds", bounds_);
  p.set("ambient", light_.ambient);
  p.set("radius", static_cast<float>(light_.slope) * top_ / glm::vec2(bounds_.z, bounds_.w));
  p.set("sum", kSumUnit);
  p.set("heights", kHeightUnit);
  p.set("stops", kBlockedUnit);
  const bool in_picture = technique_.kind == SoftTechnique::Kind::reference;
  p.set("whole", static_cast<float>(technique_.samples) / (in_picture ? 1.0F : 255.0F));
  for (const int unit : {kHeightUnit, kBlockedUnit}) {
    glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
    glBindTexture(GL_TEXTURE_2D, texture_.id());
  }
  const bool filtered = technique_.kind == SoftTechnique::Kind::average;
  glBindSampler(kHeightUnit, filtered ? compared_ : nearest_);
  glBindSampler(kBlockedUnit, compared_);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_FALSE);
  begin_translucent(Translucency::blend, Blending::darken);
  rectangle_layout_.bind();
  glDrawArrays(GL_TRIANGLE_STRIP, 0, 4);
  glDisable(GL_BLEND);
  glDepthMask(GL_TRUE);
  glBindSampler(kHeightUnit, 0);
  glBindSampler(kBlockedUnit, 0);
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace penumbra::counted
