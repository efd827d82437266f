// Layers of a light of one size as 2-D fields (docs/shadows.md#fields): without kernels, fold-overs
// or demands on the mesh.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "render/scene/scene.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// The light of one part: a disc of radius a * radius at height H above the centre.
struct PartLight {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  // plane coordinates [m]
  double radius = 0.0;                               // the part's median local thickness [m]
};

// Samples at cell centres, origin + (column + 0.5, row + 0.5) cell, rows with growing v. A layer is
// where its field, interpolated bilinearly, is > 0. Nothing outside the raster is in shadow.
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
  int cells = 256;           // along the longer side, at most
  double finest_cell = 0.0;  // cells are no smaller than this [m]
};

// `part` has the part of each vertex, `lights` one light per part. The kernels of the vertices are
// not used. Faces that are not finite are ignored; an empty caster gives an empty field.
[[nodiscard]] ShadowField power_distance_layers(std::span<const CasterVertex> vertices,
                                                std::span<const std::uint32_t> indices,
                                                std::span<const std::uint32_t> part,
                                                std::span<const PartLight> lights,
                                                const LayeredConstants& constants,
                                                const ShadowFieldOptions& options = {});

// Triangles that cover a layer, three points each.
[[nodiscard]] std::vector<PlanePoint> field_triangles(const ShadowField& field, ShadowLayer layer);
// The layer's outline as directed sides, the layer to their left. Together they are closed lines
// whose sides share end points exactly; the order is arbitrary.
struct OutlineSide {
  PlanePoint from, to;
};
[[nodiscard]] std::vector<OutlineSide> field_outline(const ShadowField& field, ShadowLayer layer);

}  // namespace penumbra
