// Rasterises the layers of meshes and fields into one mask of the light that is left on their
// plane, with antialiased edges (docs/shadows.md#silhouette-masks).
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "render/shadow/masks/mask_caster.hpp"
#include "render/shadow/masks/mask_layout.hpp"
#include "render/shadow/masks/mesh_edges.hpp"

namespace penumbra {

// The coverage of some cells, stored as differences along their rows, for reuse in other masks with
// the same cell size.
class MaskCover {
 private:
  friend class MaskRaster;
  struct Step {
    int u = 0, v = 0;  // relative to the first cell
    std::array<std::int32_t, 4> front{};
  };
  std::int64_t u_ = 0, v_ = 0;  // the first cell
  std::vector<Step> steps_;
  std::vector<std::array<std::int32_t, 4>> back_;  // one per step, or empty
  std::array<std::size_t, 3> sheets_{};            // per layer, as in MaskRaster
};

class MaskRaster {
 public:
  // Starts a mask without coverage.
  void begin(const MaskCells& cells);
  // Covers the layers of a caster that was projected onto cells of this size. `indices`, `edges`:
  // faces and edges of its mesh. Layers that the caster got as triangles or outlines are covered as
  // well. A cell gets bit for bit the same value as in a larger mask.
  void cover(MaskCaster& caster, std::span<const std::uint32_t> indices,
             std::span<const SharedEdge> edges);
  // Adds a cover, which must lie within the mask's cells.
  void cover(const MaskCover& cover);
  // Moves the coverage added since begin() to `cover`.
  void take(MaskCover& cover);
  // Writes the factor on the encoded video value for each cell, 0 to 255, row by row. The darkest
  // layer over a point counts; cells on an edge get an area-weighted mean. `light`:
  // factor of each layer. Clears the coverage.
  void finish(const glm::vec3& light, std::vector<std::uint8_t>& codes);
  void finish(const glm::vec3& light, std::span<std::uint8_t> codes);
  // For each cell of `part` (with the same cell size), writes the fractions covered by umbra,
  // middle and penumbra (0 to 255, never decreasing); the fourth byte is 0. Clears the coverage.
  void finish_coverage(const MaskCells& part, std::span<std::uint8_t> rgba);

 private:
  using Steps = std::vector<std::array<std::int32_t, 4>>;
  using Position = MaskCaster::Position;  // here relative to the mask's corner

  // `first`: origin of the caster's positions, from the mask's corner [1/256 cell].
  void cover_outlines(const MaskCaster& caster, std::span<const SharedEdge> edges,
                      const Position& first);
  void cover_counter_clockwise(const MaskCaster& caster, std::span<const std::uint32_t> indices,
                               const Position& first);
  void cover_faces(std::span<const Position> points, std::size_t layer, const Position& first);
  void cover_lines(std::span<const Position> points, std::size_t layer, const Position& first);
  void add_face(Steps& to, std::size_t layer, const std::array<Position, 3>& corners);
  // `sign` -1: reverses the edge.
  void add_edge(Steps& sums, std::size_t layer, const Position& from, const Position& to,
                int sign = 1);
  // Ensures that a layer's sums can hold this number of further sheets (faces over a cell).
  void make_room(std::size_t layer, std::size_t sheets);
  void clamp_sums();
  // Sums up a row into changed_ and covered_, then clears it. Returns the number of changes.
  std::size_t finish_row(std::size_t row);
  // Returns the cell of change i, or the end of the row.
  [[nodiscard]] std::ptrdiff_t begin_of(std::size_t i, std::size_t count) const;

  MaskCells cells_;
  // Covered area of each cell minus that of the previous cell, per layer; rows have at least one
  // cell more than the mask. steps_: counter-clockwise faces; back_: clockwise faces, if a mesh is
  // covered face by face.
  Steps steps_;
  Steps back_;
  bool has_back_ = false;
  std::array<std::size_t, 3> sheets_{};  // maximum number of faces over a cell, per layer
  std::vector<std::uint8_t> touched_;    // 1 for each step changed by an edge
  std::size_t row_cells_ = 0;            // cells per row of steps_, back_ and touched_
  std::vector<std::uint32_t> changed_;   // touched cells of a row
  std::array<std::vector<std::int32_t>, 3> covered_;  // area that a layer covers from each cell on
  std::vector<std::uint8_t> changed_codes_;           // mask values from each touched cell on
};

}  // namespace penumbra
