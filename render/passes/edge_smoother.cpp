#include "render/passes/edge_smoother.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace penumbra {
namespace {

// Neighbours of an edge's pixels, which give the colours of its sides.
constexpr float kMargin_px = 2.0F;

// Returns the part of the image that contains the edges; empty if there is none.
PixelRect bounds_of(std::span<const EdgeGroup> groups, int width, int height) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  glm::vec2 low(kInfinity);
  glm::vec2 high(-kInfinity);
  for (const EdgeGroup& group : groups) {
    for (const ScreenEdge& edge : group.edges) {
      for (const glm::vec2& p : {edge.from, edge.to}) {
        // Comparisons leave out numbers that are not finite.
        for (int axis = 0; axis < 2; ++axis) {
          if (p[axis] < low[axis]) low[axis] = p[axis];
          if (p[axis] > high[axis]) high[axis] = p[axis];
        }
      }
    }
  }
  const auto limited = [](float value, int size) {
    return static_cast<int>(std::clamp(value, 0.0F, static_cast<float>(size)));
  };
  PixelRect rect;
  rect.x = limited(std::floor(low.x - kMargin_px), width);
  rect.y = limited(std::floor(low.y - kMargin_px), height);
  rect.width = limited(std::ceil(high.x + kMargin_px), width) - rect.x;
  rect.height = limited(std::ceil(high.y + kMargin_px), height) - rect.y;
  return rect;
}

}  // namespace

int EdgeSmoother::smooth(const DrawContext& context, const FramePlan& plan) {
  // A screen-door has no values between darkened and not darkened.
  const bool blends =
      context.mode == Translucency::blend || context.mode == Translucency::retexture;
  Framebuffer& framebuffer = context.framebuffer;
  const ScreenMap screen(context.lens, framebuffer.width(), framebuffer.height());
  const std::vector<EdgeGroup> groups = edges_.of(
      context.scene, plan, screen,
      [&context](int object) { return context.objects.edges_of(object); }, blends);
  if (groups.empty()) return 0;
  const PixelRect rect = bounds_of(groups, framebuffer.width(), framebuffer.height());
  if (rect.width <= 0 || rect.height <= 0) return 0;
  image_.rect = rect;
  const auto pixels = static_cast<std::size_t>(rect.width) * static_cast<std::size_t>(rect.height);
  image_.rgba.resize(4 * pixels);
  image_.depth.resize(pixels);
  framebuffer.read_part(rect, image_.rgba, image_.depth);
  // lens.glsl: the depth in clip coordinates is (x * z + y) / z; the buffer's is half of it + 0.5.
  constexpr float kLargestDepth = 16777215.0F;
  const glm::vec2& depth = context.lens.depth;
  image_.depth_scale = {2.0F / (kLargestDepth * depth.y), (-1.0F - depth.x) / depth.y};
  image_.far = (1.0F - depth.x) / depth.y * 1.001F;
  const VideoPixels video(context.frame);
  const bool same_pixels = context.video_format.has_value() &&
                           context.frame.width == framebuffer.width() &&
                           context.frame.height == framebuffer.height();
  image_.video = same_pixels ? &video : nullptr;
  image_.planes.clear();
  image_.screen = &screen;
  // See Receivers::begin_frame().
  if (plan.volume_lights > 0 || plan.receivers.size() > 1) {
    for (const PlaneReceiver& receiver : plan.receivers)
      image_.planes.push_back(inverse_depth(plan.T_table_camera, receiver.frame));
  }
  const int changed = blender_.blend(image_, groups);
  image_.video = nullptr;
  image_.screen = nullptr;
  if (changed > 0) framebuffer.write_part(rect, image_.rgba);
  return changed;
}

}  // namespace penumbra
