#include "render/edges/screen_map.hpp"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace penumbra {
namespace {

constexpr float kPiece_px = 12.0F;  // longest piece of an edge that the lens bends

glm::vec2 distorted(const LensUniforms& lens, const glm::vec2& p) {
  const float r2 = glm::dot(p, p);
  if (lens.model == 3) {
    const float r = std::sqrt(r2);
    if (r < 1e-4F) return p;
    const float theta = std::atan(r);
    const float t2 = theta * theta;
    const glm::vec4& k = lens.k_low;
    return p * (theta * (1.0F + t2 * (k.x + t2 * (k.y + t2 * (k.z + t2 * k.w)))) / r);
  }
  float radial = 1.0F + r2 * (lens.k_low.x + r2 * (lens.k_low.y + r2 * lens.k_high.x));
  if (lens.model == 2)
    radial /= 1.0F + r2 * (lens.k_high.y + r2 * (lens.k_high.z + r2 * lens.k_high.w));
  const glm::vec2 tangential(
      lens.k_low.z * 2.0F * p.x * p.y + lens.k_low.w * (r2 + 2.0F * p.x * p.x),
      lens.k_low.z * (r2 + 2.0F * p.y * p.y) + lens.k_low.w * 2.0F * p.x * p.y);
  return p * radial + tangential;
}

}  // namespace

ScreenMap::ScreenMap(const LensUniforms& lens, int width, int height)
    : lens_(lens),
      half_size_(0.5F * static_cast<float>(width), 0.5F * static_cast<float>(height)),
      focal_px_(lens.scale_offset.x * half_size_.x, lens.scale_offset.y * half_size_.y) {}

glm::vec3 ScreenMap::operator()(const glm::vec3& p) const {
  const float near = 1.0F / p.z;
  glm::vec2 at(p.x * near, p.y * near);
  if (lens_.model != 0) {
    const float r = glm::length(at);
    at = r <= lens_.max_radius
             ? distorted(lens_, at)
             : distorted(lens_, at * (lens_.max_radius / r)) * (r / lens_.max_radius);
  }
  return {half_size_.x * (lens_.scale_offset.x * at.x + lens_.scale_offset.z + 1.0F),
          half_size_.y * (lens_.scale_offset.y * at.y + lens_.scale_offset.w + 1.0F), near};
}

glm::vec2 ScreenMap::ray(const glm::vec2& pixel) const {
  const glm::vec2 target =
      (pixel / half_size_ - 1.0F - glm::vec2(lens_.scale_offset.z, lens_.scale_offset.w)) /
      glm::vec2(lens_.scale_offset.x, lens_.scale_offset.y);
  if (lens_.model == 0) return target;
  constexpr int kSteps = 8;  // of the fixed-point iteration
  glm::vec2 at = target;
  for (int i = 0; i < kSteps; ++i) at += target - distorted(lens_, at);
  return at;
}

void ScreenMap::add(const glm::vec3& a, const glm::vec3& b, const glm::vec3& normal, int pieces,
                    std::vector<ScreenEdge>& edges) const {
  constexpr auto kNearest = static_cast<float>(kNear);
  if (!(a.z >= kNearest || b.z >= kNearest)) return;
  glm::vec3 from = a;
  glm::vec3 to = b;
  if (!(from.z >= kNearest)) from = a + (b - a) * ((kNearest - a.z) / (b.z - a.z));
  if (!(to.z >= kNearest)) to = b + (a - b) * ((kNearest - b.z) / (a.z - b.z));
  // The surface's plane normal . p = normal . a has 1 / z = normal . (x, y, 1) / (normal . a).
  const float offset = glm::dot(normal, a);
  const glm::vec2 slope =
      offset != 0.0F ? glm::vec2(normal.x, normal.y) / (offset * focal_px_) : glm::vec2(0.0F);
  glm::vec3 start = (*this)(from);
  int count = 1;
  if (distorts() && pieces > 1) {
    const glm::vec3 end = (*this)(to);
    const float length = glm::length(glm::vec2(end) - glm::vec2(start));
    if (!(length < 1e6F)) return;
    count = std::clamp(static_cast<int>(length / kPiece_px) + 1, 1, pieces);
  }
  for (int i = 1; i <= count; ++i) {
    const float t = static_cast<float>(i) / static_cast<float>(count);
    const glm::vec3 end = (*this)(i == count ? to : from + t * (to - from));
    edges.push_back({glm::vec2(start), glm::vec2(end), start.z, end.z, slope});
    start = end;
  }
}

}  // namespace penumbra
