// Computes the outline of a layer: the union of its projected triangles, as polygons with holes.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

struct LayerPolygon {
  std::vector<Eigen::Vector2d> outer;  // counter-clockwise [m], first corner not repeated
  std::vector<std::vector<Eigen::Vector2d>> holes;  // clockwise
};

struct LayerOutline {
  double area = 0.0;  // [m^2]
  std::vector<LayerPolygon> polygons;
};

struct NamedOutline {
  std::string name;  // "umbra", "middle", "penumbra", "shadow"
  LayerOutline outline;
};

// Takes three points per triangle, of either orientation; triangles may overlap. Coordinates are
// rounded to 1e-9 of the layer's size; polygons under 1e-12 m^2 are dropped. A boundary with more
// than `max_edges` edges is united in pieces, because Clipper computes all crossings inside the
// union, hundreds of millions for a triangle soup.
[[nodiscard]] Result<LayerOutline> union_of_triangles(std::span<const PlanePoint> triangles,
                                                      std::size_t max_edges = 6000);

}  // namespace penumbra
