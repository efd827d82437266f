// A mesh or a field projected onto the cells of a mask (docs/shadows.md#silhouette-masks).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/layers/own_frame.hpp"
#include "render/shadow/masks/mask_layout.hpp"

namespace penumbra {

// Kept between frames for its memory.
class MaskCaster {
 public:
  // Starts without any layer, on cells of this size [m].
  void begin(const OwnFrame& own, double cell);
  // Gives a layer as triangles in the own frame [m], three points each, of a mesh whose edges are
  // paired or of oriented faces, cut or not. Those that are not finite are ignored; places are
  // clamped to 2 million cells from the object's origin.
  void project_faces(ShadowLayer layer, std::span<const PlanePoint> triangles);
  // Gives a layer as closed lines in the own frame [m], the layer to the left of each side.
  void project_outline(ShadowLayer layer, std::span<const OutlineSide> sides);
  // Begins, and gives the wanted layers of a mesh that lies within their heights. Vertices and
  // kernels: object frame [m], one each. Places are rounded to 1/256 cell and clamped as above.
  void project(std::span<const glm::vec3> positions, std::span<const glm::vec3> kernels,
               const OwnFrame& own, const LayeredConstants& constants,
               const std::array<bool, 3>& wanted, double cell);
  // The cells of all layers; empty where none is wanted.
  [[nodiscard]] const CellBox& bounds() const { return bounds_; }

 private:
  friend class MaskRaster;
  static constexpr int kPlaceBits = 8;
  static constexpr int kPlaces = 1 << kPlaceBits;  // in a cell, along each side
  // In 1/256 cells from the cell under the object's origin.
  using Place = Eigen::Vector<std::int64_t, 2>;
  // (u, v) of a vertex in each layer, whole numbers; in wanted layers both finite or both NaN.
  struct Images {
    alignas(16) std::array<float, 4> u;
    alignas(16) std::array<float, 4> v;
    [[nodiscard]] Place place(std::size_t layer) const {
      return {static_cast<std::int64_t>(u[layer]), static_cast<std::int64_t>(v[layer])};
    }
  };
  void clamp_places();
  // Nothing where the point is not finite.
  [[nodiscard]] std::optional<Place> place_of(const PlanePoint& p) const;
  void extend_bounds(const Place& place);

  std::vector<Images> images_;
  std::array<bool, 3> wanted_{};
  Place first_ = Place::Zero();  // the cell under the object's origin
  CellBox bounds_;
  std::vector<std::uint8_t> turned_;  // per face, a bit for each layer
  PlanarMotion T_plane_own_;
  double cell_ = 0.0;
  std::array<std::vector<Place>, 3> faces_;  // three points each
  std::array<std::vector<Place>, 3> sides_;  // two points each
};

}  // namespace penumbra
