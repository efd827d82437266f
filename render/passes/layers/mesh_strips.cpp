#include "render/passes/layers/mesh_strips.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

constexpr double kPeriod = 3e-3;      // [m]
constexpr double kHalfTable = 0.3;    // half the table's side [m]
constexpr double kFarthest = 3.0;     // maximum distance of strips [m]
constexpr unsigned kFullLevel = 127;  // level at which the strips cover the plane

}  // namespace

Result<MeshStrips> MeshStrips::create(GlApi api, const CameraModel& camera) {
  MeshStrips strips;
  PENUMBRA_TRY(strips.program_,
               ShaderProgram::link(api, {"lens.glsl", "mesh_strip.vert.glsl"}, {"fill.frag.glsl"}));
  strips.piece_ = camera.has_distortion() ? longest_edge(camera) : kHalfTable;
  strips.corners_.write(
      std::vector<glm::vec2>{glm::vec2(0, 0), glm::vec2(1, 0), glm::vec2(0, 1), glm::vec2(1)});
  return strips;
}

unsigned MeshStrips::level_of(float factor) {
  const double lost = 1.0 - std::pow(std::clamp(static_cast<double>(factor), 0.0, 1.0), 2.2);
  return static_cast<unsigned>(std::lround(kFullLevel * lost));
}

int MeshStrips::draw(unsigned level, const Eigen::AlignedBox2d& bounds, const LensUniforms& lens,
                     const glm::mat4x3& camera_from_plane) const {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(-kHalfTable);
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
  const double width = kPeriod * std::min(level, kFullLevel) / kFullLevel;
  program_.use();
  set_lens(program_, lens);
  program_.set("camera_from_plane", camera_from_plane);
  program_.set("value", glm::vec4(0.0F, 0.0F, 0.0F, 1.0F));
  program_.set("first_strip", first(low.x(), kPeriod));
  program_.set("first_piece", first(low.y(), piece_));
  program_.set("pieces", pieces);
  program_.set("strip", glm::vec3(static_cast<float>(kPeriod), static_cast<float>(width),
                                  static_cast<float>(piece_)));
  corners_.bind();
  glDrawArraysInstanced(GL_TRIANGLE_STRIP, 0, 4, strips * pieces);
  return 1;
}

}  // namespace penumbra
