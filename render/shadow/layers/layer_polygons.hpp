// The outline of a layer: the union of its projected triangles as polygons with holes.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

struct LayerPolygon {
  std::vector<Eigen::Vector2d> outer;  // counter-clockwise [m], not closed by repetition
  std::vector<std::vector<Eigen::Vector2d>> holes;  // clockwise
};

struct LayerOutline {
  double area = 0.0;  // [m^2]
  std::vector<LayerPolygon> polygons;
};

// Three points per triangle, either orientation, overlapping as they like. Coordinates are rounded
// to 1e-9 of the layer's size. Specks under 1e-12 m^2 are left out.
//
// A boundary of more edges than `edges_at_once` (those that two neighbours share do not count) is
// made in pieces, which are united. The union is the same, but for that rounding: a polygon library
// finds every crossing of two edges, also those that the union covers, and a soup of faces has
// hundreds of millions of them.
[[nodiscard]] Result<LayerOutline> union_of_triangles(std::span<const PlanePoint> triangles,
                                                      std::size_t edges_at_once = 6000);

}  // namespace penumbra
