// Lines in the image at which surfaces or shadows end.
#pragma once

#include <cstdint>
#include <glm/vec2.hpp>
#include <vector>

namespace penumbra {

// Pixel (i, j) of an image covers [i, i + 1) x [j, j + 1); y points down. Depths are inverse, 1 / z
// [1/m]: over a plane they are linear in the image.
struct ScreenEdge {
  glm::vec2 from{0.0F}, to{0.0F};  // [px]; what has the edge is on the left, seen along from -> to
  float near_from = 0.0F, near_to = 0.0F;  // inverse depth at both ends
  glm::vec2 near_slope{0.0F};              // change of its surface's inverse depth per pixel
};

enum class EdgeKind : std::uint8_t {
  surface,          // outline of a surface with depth
  phantom,          // the same, of a real object: the surface shows the video
  crease,           // between two faces of a surface
  blended,          // outline or crease of a surface without depth
  shadow_on_plane,  // outline of a shadow; the left is dark
  shadow_on_phantom,
  shadow_on_object,
};
// Edges whose left sides belong together. Where several groups have edges, each changes the pixel,
// one after the other. Creases must follow all outlines.
struct EdgeGroup {
  EdgeKind kind = EdgeKind::surface;
  std::vector<ScreenEdge> edges;
};

}  // namespace penumbra
