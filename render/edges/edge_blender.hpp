// Smooths edges of an image that was drawn with one sample per pixel, without drawing it again
// (docs/rendering.md#edges-without-multisampling).
//
// Each edge is a line between two surfaces. A pixel that it crosses gets the exact area that lies
// on the other side of the line than the pixel's centre, and mixes the colour of that side in.
#pragma once

#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/image/pixel_rect.hpp"
#include "render/edges/screen_edge.hpp"
#include "render/edges/screen_map.hpp"
#include "render/edges/video_pixels.hpp"

namespace penumbra {

// The part of an image that has edges. Rows top to bottom.
struct EdgeImage {
  PixelRect rect;
  std::vector<std::uint8_t> rgba;    // as drawn
  std::vector<std::uint32_t> depth;  // depth in the upper 24 bits, as read from the depth buffer
  // Inverse depth = depth_scale.x * depth / (2^24 - 1) + depth_scale.y.
  glm::vec2 depth_scale{0.0F};
  float far = 0.0F;  // inverse depth of pixels that no surface covers
  // The video under the image, pixel for pixel; null: unknown. Edges over it then mix with the
  // video of the neighbouring pixel.
  const VideoPixels* video = nullptr;
  // Planes in the depth buffer, which show the video: their inverse depth at the ray (x, y) is
  // dot(plane, (x, y, 1)). If there are some, `screen` is not null.
  std::vector<glm::vec3> planes;
  const ScreenMap* screen = nullptr;
};

class EdgeBlender {
 public:
  // Smooths the image's edges. Returns the number of pixels that it changed. Edges may lie outside
  // of the image, and may not be finite.
  int blend(EdgeImage& image, std::span<const EdgeGroup> groups);

 private:
  // The edges of a group in one pixel.
  struct Cell {
    int x = 0, y = 0;      // in the rectangle
    float area = 0.0F;     // > 0: part on the left, seen from a centre on the right; < 0: part on
                           // the right, seen from a centre on the left
    glm::vec2 left{0.0F};  // direction to the left, times length
    float length = 0.0F;   // of the edges in the pixel [px]
    float near = 0.0F;     // inverse depth, times length
    float surface = 0.0F;  // inverse depth of the surface at the centre, times length
    glm::vec2 near_slope{0.0F};  // times length
  };
  struct Neighbour {
    int x = 0, y = 0;
  };

  void add(const ScreenEdge& edge);
  void add_piece(const ScreenEdge& edge, int x, int y, const glm::vec2& a, const glm::vec2& b,
                 float near);
  [[nodiscard]] float near_at(int x, int y) const;
  [[nodiscard]] bool shows_video(const Neighbour& at) const;
  [[nodiscard]] bool fits(const Cell& cell, int x, int y, bool left) const;
  [[nodiscard]] std::optional<Neighbour> neighbour(const Cell& cell, const glm::vec2& towards,
                                                   bool left) const;
  // Returns the colour of the surface at pixel `from` as it would be at the cell's pixel.
  [[nodiscard]] glm::vec3 colour(const Cell& cell, const Neighbour& from, bool left) const;
  // Returns the index of a pixel of the rectangle.
  [[nodiscard]] std::size_t index_of(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(image_->rect.width) +
           static_cast<std::size_t>(x);
  }
  [[nodiscard]] glm::vec3 drawn_at(int x, int y) const {
    const std::uint8_t* codes = drawn_.data() + 4 * index_of(x, y);
    return {static_cast<float>(codes[0]), static_cast<float>(codes[1]),
            static_cast<float>(codes[2])};
  }
  [[nodiscard]] bool outlined(int x, int y) const { return outlined_[index_of(x, y)] != 0; }
  bool blend(const Cell& cell);

  EdgeImage* image_ = nullptr;
  EdgeKind kind_ = EdgeKind::surface;
  std::vector<std::uint8_t> drawn_;   // the image before it is changed
  std::vector<std::uint32_t> slots_;  // for each pixel: 1 + index into cells_, or 0
  std::vector<Cell> cells_;
  std::vector<std::uint8_t> outlined_;  // for each pixel: 1 if a visible outline crosses it
};

}  // namespace penumbra
