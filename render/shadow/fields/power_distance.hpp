// Computes shadow layers as 2-D fields, for one light size per part (docs/shadows.md#fields).
// Needs no kernels, works for any mesh, and never folds over.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "render/scene/scene.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// The light of one part: a disc of radius light_ratio * radius, light_height above the plane.
struct PartLight {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  // plane coordinates [m]
  double radius = 0.0;                               // the part's median local thickness [m]
};

// Samples at cell centres, origin + (column + 0.5, row + 0.5) cell, in plane coordinates. A layer
// is the set of points whose bilinearly interpolated field is > 0. No shadow outside the raster.
struct ShadowField {
  int width = 0;      // [cells]
  int height = 0;     // [cells]
  double cell = 0.0;  // [m]
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();
  std::vector<float> umbra, middle, penumbra;  // [cells^2]

  [[nodiscard]] const std::vector<float>& layer(ShadowLayer which) const {
    return which == ShadowLayer::umbra ? umbra : which == ShadowLayer::middle ? middle : penumbra;
  }
};

struct ShadowFieldOptions {
  int cells = 256;           // maximum along the longer side
  double finest_cell = 0.0;  // minimum cell size [m]
};

// Computes a caster's field. `part`: part index of each vertex; `lights`: one per part. Ignores the
// vertices' kernels and non-finite faces. An empty caster gives an empty field.
[[nodiscard]] ShadowField power_distance_layers(std::span<const CasterVertex> vertices,
                                                std::span<const std::uint32_t> indices,
                                                std::span<const std::uint32_t> part,
                                                std::span<const PartLight> lights,
                                                const LayeredConstants& constants,
                                                const ShadowFieldOptions& options = {});

// Returns triangles that cover a layer, three points each.
[[nodiscard]] std::vector<PlanePoint> field_triangles(const ShadowField& field, ShadowLayer layer);
// A directed segment of a layer's outline, with the layer to its left. The segments, in any order,
// form closed lines: consecutive segments have exactly equal end points.
struct OutlineSide {
  PlanePoint from, to;
};
[[nodiscard]] std::vector<OutlineSide> field_outline(const ShadowField& field, ShadowLayer layer);

}  // namespace penumbra
