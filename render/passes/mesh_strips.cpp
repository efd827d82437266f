#include "render/passes/mesh_strips.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/vec2.hpp>

#include "core/propagate.hpp"
#include "render/passes/lens_uniforms.hpp"

namespace penumbra {
namespace {

constexpr double kPeriod = 3e-3;    // [m]
constexpr double kTable = 0.3;      // half its side [m]
constexpr double kFarthest = 3.0;   // strips beyond this [m] are left out
constexpr unsigned kDarkest = 127;  // level: black all over

}  // namespace

Result<MeshStrips> MeshStrips::create(GlApi api, const CameraModel& camera) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "mesh_strip.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFragment = {"fill.frag.glsl"};
  PENUMBRA_TRY(auto program, ShaderProgram::link(api, kVertex, kFragment));
  MeshStrips strips(std::move(program));
  strips.piece_ = camera.has_distortion() ? longest_edge(camera) : kTable;
  const std::array<glm::vec2, 4> corners = {glm::vec2(0, 0), glm::vec2(1, 0), glm::vec2(0, 1),
                                            glm::vec2(1, 1)};
  strips.layout_.bind();
  strips.vertices_.write(std::span<const glm::vec2>(corners));
  VertexArray::attribute(0, 2, sizeof(glm::vec2), 0);
  return strips;
}

unsigned MeshStrips::level_of(float light_left) {
  const double lost = 1.0 - std::pow(std::clamp(static_cast<double>(light_left), 0.0, 1.0), 2.2);
  return static_cast<unsigned>(std::lround(kDarkest * lost));
}

int MeshStrips::draw(unsigned level, const Eigen::AlignedBox2d& bounds, const LensUniforms& lens,
                     const glm::mat4x3& camera_from_plane) const {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(-kTable);
  Eigen::Vector2d high = -low;
  if (!bounds.isEmpty()) {
    low = low.cwiseMin(bounds.min()).cwiseMax(-kFarthest);
    high = high.cwiseMax(bounds.max()).cwiseMin(kFarthest);
  }
  const auto first = [&](double at, double step) {
    return static_cast<int>(std::floor(at / step));
  };
  const auto count = [&](double from, double to, double step) {
    return static_cast<int>(std::ceil(to / step)) - first(from, step);
  };
  const int strips = count(low.x(), high.x(), kPeriod);
  const int pieces = count(low.y(), high.y(), piece_);
  const double width = kPeriod * std::min(level, kDarkest) / kDarkest;
  program_.use();
  set_lens(program_, lens);
  program_.set("camera_from_plane", camera_from_plane);
  program_.set("value", glm::vec4(0.0F, 0.0F, 0.0F, 1.0F));
  program_.set("first_strip", first(low.x(), kPeriod));
  program_.set("first_piece", first(low.y(), piece_));
  program_.set("pieces", pieces);
  program_.set("strip", glm::vec3(static_cast<float>(kPeriod), static_cast<float>(width),
                                  static_cast<float>(piece_)));
  layout_.bind();
  glDrawArraysInstanced(GL_TRIANGLE_STRIP, 0, 4, strips * pieces);
  return 1;
}

}  // namespace penumbra
