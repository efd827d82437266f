#include "render/edges/edge_blender.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>

namespace penumbra {
namespace {

constexpr float kLeastArea = 1.0F / 512.0F;  // of a pixel; smaller parts change no code
// Relative tolerances of inverse depths. Surfaces that are nearer to each other count as one.
constexpr float kHidden = 5e-3F;   // an edge is hidden by what is nearer by more than this
constexpr float kOnPlane = 2e-4F;  // what is nearer than the plane by more than this is not on it
constexpr float kOnSurface = 1e-2F;
constexpr float kOfPlane = 2e-3F;  // a pixel with a plane's depth shows the plane
// Rounding may put the pixel's centre on the other side of an edge that halves the pixel.
constexpr float kHalf = 0.46F;
// Edges that reach farther out of the image are ignored, because float would lose their position.
constexpr float kFarthest_px = 1e5F;

// The area that a piece of an edge, which stays left or right of the pixel's centre, adds.
float area_beside(float x0, float x1, float height, bool right) {
  const float middle = 0.5F * (x0 + x1);
  return right ? height * (0.5F - middle) : -height * (0.5F + middle);
}

// Returns the signed area that a piece of an edge adds to Cell::area. Points are relative to the
// pixel's centre. Every other point of the pixel is reached from the centre along its column and
// then along the row; it is on the other side if this path crosses the edge.
float area_of(const glm::vec2& a, const glm::vec2& b) {
  const bool right = a.x >= 0.0F;
  if (right == (b.x >= 0.0F)) return area_beside(a.x, b.x, b.y - a.y, right);
  const float y = a.y + (b.y - a.y) * (a.x / (a.x - b.x));
  const float sign = b.x > a.x ? -1.0F : 1.0F;
  const float rows = y >= 0.0F ? 0.5F - y : -0.5F - y;
  return sign * rows + area_beside(a.x, 0.0F, y - a.y, right) +
         area_beside(0.0F, b.x, b.y - y, !right);
}

bool is_shadow(EdgeKind kind) {
  return kind == EdgeKind::shadow_on_plane || kind == EdgeKind::shadow_on_phantom ||
         kind == EdgeKind::shadow_on_object;
}

float distance(const glm::vec3& a, const glm::vec3& b) {
  return glm::dot(a - b, a - b);
}

}  // namespace

float EdgeBlender::near_at(int x, int y) const {
  const std::uint32_t depth = image_->depth[index_of(x, y)] >> 8U;
  return image_->depth_scale.x * static_cast<float>(depth) + image_->depth_scale.y;
}

bool EdgeBlender::shows_video(const Neighbour& at) const {
  const float near = near_at(at.x, at.y);
  if (near <= image_->far) return true;
  if (image_->planes.empty()) return false;
  const glm::vec2 pixel(static_cast<float>(image_->rect.x + at.x) + 0.5F,
                        static_cast<float>(image_->rect.y + at.y) + 0.5F);
  const glm::vec3 ray(image_->screen->ray(pixel), 1.0F);
  return std::ranges::any_of(image_->planes, [&](const glm::vec3& plane) {
    const float of_plane = glm::dot(plane, ray);
    return std::abs(near - of_plane) <= kOfPlane * of_plane;
  });
}

void EdgeBlender::add_piece(const ScreenEdge& edge, int x, int y, const glm::vec2& a,
                            const glm::vec2& b, float near) {
  const glm::vec2 middle = 0.5F * (a + b);
  const float here = near_at(x, y);
  const float surface = near - glm::dot(edge.near_slope, middle);  // at the pixel's centre
  switch (kind_) {
    case EdgeKind::surface:
    case EdgeKind::phantom:
    case EdgeKind::crease:
    case EdgeKind::blended:
      if (here > std::max(near, surface) * (1.0F + kHidden)) return;
      break;
    case EdgeKind::shadow_on_plane:
      if (here > surface * (1.0F + kOnPlane)) return;
      break;
    case EdgeKind::shadow_on_phantom:
    case EdgeKind::shadow_on_object:
      if (std::abs(here - surface) > surface * kOnSurface) return;
      break;
  }
  std::uint32_t& slot = slots_[index_of(x, y)];
  if (slot == 0) {
    cells_.emplace_back();
    cells_.back().x = x;
    cells_.back().y = y;
    slot = static_cast<std::uint32_t>(cells_.size());
  }
  Cell& cell = cells_[slot - 1];
  const glm::vec2 along = b - a;
  const float length = glm::length(along) + 1e-6F;
  cell.area += area_of(a, b);
  cell.left += glm::vec2(along.y, -along.x);
  cell.length += length;
  cell.near += length * near;
  cell.surface += length * surface;
  cell.near_slope += length * edge.near_slope;
}

// Divides the edge at the borders of pixels (Amanatides and Woo's traversal of a grid).
void EdgeBlender::add(const ScreenEdge& edge) {
  // In pixels of the image, so that rounding does not depend on the rectangle.
  const PixelRect& rect = image_->rect;
  const int end_x = rect.x + rect.width;
  const int end_y = rect.y + rect.height;
  const glm::vec2 lowest(static_cast<float>(rect.x), static_cast<float>(rect.y));
  const glm::vec2 highest(static_cast<float>(end_x), static_cast<float>(end_y));
  const glm::vec2& from = edge.from;
  const glm::vec2 along = edge.to - edge.from;
  const auto usable = [](const glm::vec2& p) {
    return std::abs(p.x) < kFarthest_px && std::abs(p.y) < kFarthest_px;  // false for NaN
  };
  if (!usable(edge.from) || !usable(edge.to)) return;
  // Clips to the rectangle (Liang and Barsky).
  float t = 0.0F;
  float last = 1.0F;
  for (int axis = 0; axis < 2; ++axis) {
    if (along[axis] == 0.0F) {
      if (!(from[axis] >= lowest[axis] && from[axis] < highest[axis])) return;
      continue;
    }
    const float low = (lowest[axis] - from[axis]) / along[axis];
    const float high = (highest[axis] - from[axis]) / along[axis];
    t = std::max(t, std::min(low, high));
    last = std::min(last, std::max(low, high));
  }
  if (!(t < last)) return;
  glm::vec2 p = t > 0.0F ? from + t * along : from;
  int x = std::clamp(static_cast<int>(p.x), rect.x, end_x - 1);
  int y = std::clamp(static_cast<int>(p.y), rect.y, end_y - 1);
  // A start on a border belongs to the pixel that the edge enters.
  if (along.x < 0.0F && x > rect.x && p.x == static_cast<float>(x)) --x;
  if (along.y < 0.0F && y > rect.y && p.y == static_cast<float>(y)) --y;
  const int step_x = along.x < 0.0F ? -1 : 1;
  const int step_y = along.y < 0.0F ? -1 : 1;
  constexpr float kNever = 2.0F;
  const float per_x = along.x == 0.0F ? kNever : 1.0F / along.x;
  const float per_y = along.y == 0.0F ? kNever : 1.0F / along.y;
  while (t < last) {
    const float border_x = static_cast<float>(along.x < 0.0F ? x : x + 1);
    const float border_y = static_cast<float>(along.y < 0.0F ? y : y + 1);
    const float at_x = along.x == 0.0F ? kNever : (border_x - from.x) * per_x;
    const float at_y = along.y == 0.0F ? kNever : (border_y - from.y) * per_y;
    const float next = std::min({at_x, at_y, last});
    glm::vec2 q = next >= 1.0F ? from + along : from + next * along;
    const glm::vec2 centre(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F);
    if (next > t) {
      const glm::vec2 half(0.5F);
      add_piece(edge, x - rect.x, y - rect.y, glm::clamp(p - centre, -half, half),
                glm::clamp(q - centre, -half, half),
                edge.near_from + 0.5F * (t + next) * (edge.near_to - edge.near_from));
    }
    if (next >= last) return;
    if (at_x <= at_y) {
      x += step_x;
      if (x < rect.x || x >= end_x) return;
    } else {
      y += step_y;
      if (y < rect.y || y >= end_y) return;
    }
    p = q;
    t = next;
  }
}

bool EdgeBlender::fits(const Cell& cell, int x, int y, bool left) const {
  const float near = cell.near / cell.length;
  const glm::vec2 offset(static_cast<float>(x - cell.x), static_cast<float>(y - cell.y));
  const float surface = (cell.surface + glm::dot(cell.near_slope, offset)) / cell.length;
  const float there = near_at(x, y);
  switch (kind_) {
    case EdgeKind::surface:
    case EdgeKind::phantom:
      return !left || there >= std::min(near, surface) * (1.0F - kOnSurface);
    case EdgeKind::crease:
      return there >= std::min(near, surface) * (1.0F - 2.0F * kOnSurface);
    case EdgeKind::blended:
      return true;
    case EdgeKind::shadow_on_plane:
      return there <= surface * (1.0F + kOnPlane);
    case EdgeKind::shadow_on_phantom:
    case EdgeKind::shadow_on_object:
      return std::abs(there - surface) <= surface * kOnSurface;
  }
  return false;
}

std::optional<EdgeBlender::Neighbour> EdgeBlender::neighbour(const Cell& cell,
                                                             const glm::vec2& towards,
                                                             bool left) const {
  const int step_x = towards.x < 0.0F ? -1 : 1;
  const int step_y = towards.y < 0.0F ? -1 : 1;
  const bool horizontal = std::abs(towards.x) > std::abs(towards.y);
  const std::array<Neighbour, 3> candidates = {
      horizontal ? Neighbour{step_x, 0} : Neighbour{0, step_y}, Neighbour{step_x, step_y},
      horizontal ? Neighbour{0, step_y} : Neighbour{step_x, 0}};
  for (const Neighbour& step : candidates) {
    const int x = cell.x + step.x;
    const int y = cell.y + step.y;
    if (x < 0 || y < 0 || x >= image_->rect.width || y >= image_->rect.height) continue;
    if (fits(cell, x, y, left)) return Neighbour{x, y};
  }
  return std::nullopt;
}

glm::vec3 EdgeBlender::colour(const Cell& cell, const Neighbour& from, bool left) const {
  const glm::vec3 there = drawn_at(from.x, from.y);
  if (image_->video == nullptr) return there;
  const bool over_video =
      kind_ == EdgeKind::shadow_on_plane || kind_ == EdgeKind::shadow_on_phantom ||
      (kind_ == EdgeKind::phantom && left) ||
      (!left && !is_shadow(kind_) && kind_ != EdgeKind::crease && shows_video(from));
  if (!over_video) return there;
  // The video is known at both pixels; the factor by which it was darkened is taken from there.
  const glm::vec3 video_there = image_->video->at(image_->rect.x + from.x, image_->rect.y + from.y);
  const glm::vec3 video_here = image_->video->at(image_->rect.x + cell.x, image_->rect.y + cell.y);
  return glm::min(video_here * (there + 1.0F) / (video_there + 1.0F), glm::vec3(255.0F));
}

bool EdgeBlender::blend(const Cell& cell) {
  float part = std::min(std::abs(cell.area), 1.0F);
  if (!(part >= kLeastArea)) return false;
  bool left = cell.area > 0.0F;  // the side that the pixel's centre is not on
  const glm::vec2 towards = left ? cell.left : -cell.left;
  const auto other = neighbour(cell, towards, left);
  if (!other) return false;
  // Beside an outline, the neighbour may show something else than the other face of the crease.
  if (kind_ == EdgeKind::crease && (outlined(cell.x, cell.y) || outlined(other->x, other->y)))
    return false;
  const glm::vec3 here = drawn_at(cell.x, cell.y);
  glm::vec3 mixed_in = colour(cell, *other, left);
  if (part > kHalf) {
    const auto own = neighbour(cell, -towards, !left);
    if (own) {
      const glm::vec3 own_colour = colour(cell, *own, !left);
      if (distance(here, mixed_in) < distance(here, own_colour)) {
        part = 1.0F - part;
        mixed_in = own_colour;
      }
    }
  }
  std::uint8_t* after = image_->rgba.data() + 4 * index_of(cell.x, cell.y);
  bool changed = false;
  for (int channel = 0; channel < 3; ++channel) {
    const float value = static_cast<float>(after[channel]) +
                        part * (mixed_in[channel] - static_cast<float>(after[channel]));
    const auto code = static_cast<std::uint8_t>(std::clamp(value + 0.5F, 0.0F, 255.0F));
    changed = changed || code != after[channel];
    after[channel] = code;
  }
  return changed;
}

int EdgeBlender::blend(EdgeImage& image, std::span<const EdgeGroup> groups) {
  image_ = &image;
  drawn_ = image.rgba;
  const std::size_t pixels =
      static_cast<std::size_t>(image.rect.width) * static_cast<std::size_t>(image.rect.height);
  slots_.resize(pixels);
  outlined_.assign(pixels, 0);
  int changed = 0;
  for (const EdgeGroup& group : groups) {
    kind_ = group.kind;
    for (const ScreenEdge& edge : group.edges) add(edge);
    for (const Cell& cell : cells_) {
      changed += blend(cell) ? 1 : 0;
      const std::size_t pixel = index_of(cell.x, cell.y);
      slots_[pixel] = 0;
      if (kind_ == EdgeKind::surface || kind_ == EdgeKind::phantom) outlined_[pixel] = 1;
    }
    cells_.clear();
  }
  image_ = nullptr;
  return changed;
}

}  // namespace penumbra
