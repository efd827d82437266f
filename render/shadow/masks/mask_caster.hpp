// Projects a mesh or a field onto the cells of a mask (docs/shadows.md#silhouette-masks).
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

// Serves many frames and reuses its memory.
class MaskCaster {
 public:
  static constexpr int kSubcellBits = 8;
  static constexpr int kSubcells = 1 << kSubcellBits;  // subdivisions of a cell's side
  // Removes all layers and sets the cell size [m].
  void begin(const OwnFrame& own, double cell);
  // Adds a layer as triangles in the own frame [m], three points each. The mesh has paired edges
  // (SharedEdge) or oriented faces, and may be clipped. Non-finite triangles are ignored; positions
  // are clamped to 2 million cells from the object's origin.
  void project_faces(ShadowLayer layer, std::span<const PlanePoint> triangles);
  // Adds a layer as closed outlines in the own frame [m], with the layer to the left of each side.
  void project_outline(ShadowLayer layer, std::span<const OutlineSide> sides);
  // Calls begin() and adds the wanted layers of a mesh that lies within their height ranges.
  // `positions` and `kernels`: object frame [m], one kernel per position. Positions on the plane
  // are rounded to 1/256 cell and clamped as in project_faces().
  void project(std::span<const glm::vec3> positions, std::span<const glm::vec3> kernels,
               const OwnFrame& own, const LayeredConstants& constants,
               const std::array<bool, 3>& wanted, double cell);
  // Returns the cells of all layers; empty if there is none.
  [[nodiscard]] const CellBox& bounds() const { return bounds_; }

 private:
  friend class MaskRaster;
  // [1/256 cell], relative to the cell under the object's origin.
  using Position = Eigen::Vector<std::int64_t, 2>;
  // Integral (u, v) of a vertex in each layer. In a wanted layer, both are finite or both are NaN.
  struct Images {
    alignas(16) std::array<float, 4> u;
    alignas(16) std::array<float, 4> v;
    [[nodiscard]] Position layer_position(std::size_t layer) const {
      return {static_cast<std::int64_t>(u[layer]), static_cast<std::int64_t>(v[layer])};
    }
  };
  void clamp_positions();
  // Returns nullopt if the point is not finite.
  [[nodiscard]] std::optional<Position> position_of(const PlanePoint& p) const;
  void extend_bounds(const Position& position);

  std::vector<Images> images_;
  std::array<bool, 3> wanted_{};
  Position first_ = Position::Zero();  // the cell under the object's origin
  CellBox bounds_;
  std::vector<std::uint8_t>
      counter_clockwise_;  // per face: a bit per layer, set if counter-clockwise
  PlanarMotion T_plane_own_;
  double cell_ = 0.0;
  std::array<std::vector<Position>, 3> faces_;  // three points each
  std::array<std::vector<Position>, 3> sides_;  // two points each
};

}  // namespace penumbra
