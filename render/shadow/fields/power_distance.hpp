// Layers of a light of one size, as fields instead of scaled meshes (docs/shadows.md#fields): no
// kernels, no demands on the mesh, and nothing that could twist.
//
// Every vertex is projected from the light's centre and carries the radius rho of the light's image
// there. With the power distance D(x) = min over p of |x - p|^2 - rho(p)^2:
//   penumbra = where D over the covered cells is <= 0 (some of the light is hidden)
//   middle   = the covered cells                      (the light's centre is hidden)
//   umbra    = covered cells where D over the cells just outside the outline is > 0 (all is hidden)
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
  double radius = 0.0;                               // of the part: its median local thickness [m]
};

// Samples at cell centres, origin + (column + 0.5, row + 0.5) cell, rows with growing v. A layer is
// where its field, interpolated bilinearly, is > 0; values are in cells^2, and outside the raster
// nothing is in shadow.
struct ShadowField {
  int width = 0;      // [cells]
  int height = 0;     // [cells]
  double cell = 0.0;  // [m]
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();
  std::vector<float> umbra, middle, penumbra;

  [[nodiscard]] const std::vector<float>& layer(ShadowLayer which) const {
    return which == ShadowLayer::umbra ? umbra : which == ShadowLayer::middle ? middle : penumbra;
  }
  // Bilinear; -1 outside the raster.
  [[nodiscard]] float sample(ShadowLayer which, const Eigen::Vector2d& p) const;
};

// Of a light at a finite height, where the umbra of the lower matter alone comes from.
enum class FieldLevels {
  from_one_raster,  // of the whole part's cells, those with matter below the level
  cut,              // faces cut at the level, on a raster of their own: exact, and slower
};

struct ShadowFieldOptions {
  int cells = 256;           // along the longer side, at most
  double finest_cell = 0.0;  // cells are no smaller than this [m]
  FieldLevels levels = FieldLevels::from_one_raster;
};

// `part` gives the part of each vertex; `lights` has one light per part. Kernels of the vertices
// are not used. Total: faces that are not finite are left out, and an empty caster gives an empty
// field.
[[nodiscard]] ShadowField power_distance_layers(std::span<const CasterVertex> vertices,
                                                std::span<const std::uint32_t> indices,
                                                std::span<const std::uint32_t> part,
                                                std::span<const PartLight> lights,
                                                const LayeredConstants& constants,
                                                const ShadowFieldOptions& options = {});

// Triangles that cover a layer's inside, bounded by the zero contour of its field: three points
// each, for union_of_triangles.
[[nodiscard]] std::vector<PlanePoint> field_triangles(const ShadowField& field, ShadowLayer layer);
// What bounds those, each side once and the inside to its left: closed lines, in no order, that
// meet in points that are equal to the bit.
struct OutlineSide {
  PlanePoint from, to;
};
[[nodiscard]] std::vector<OutlineSide> field_outline(const ShadowField& field, ShadowLayer layer);

}  // namespace penumbra
