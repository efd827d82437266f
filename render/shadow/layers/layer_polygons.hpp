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

// Three points per triangle, of either orientation; triangles may overlap. Coordinates are rounded
// to 1e-9 of the layer's size; specks under 1e-12 m^2 are dropped. Triangles with a boundary of
// more edges than `edges_at_once` are united in pieces: else Clipper would find all crossings of
// edges inside the union, of which a soup of faces has hundreds of millions.
[[nodiscard]] Result<LayerOutline> union_of_triangles(std::span<const PlanePoint> triangles,
                                                      std::size_t edges_at_once = 6000);

}  // namespace penumbra
