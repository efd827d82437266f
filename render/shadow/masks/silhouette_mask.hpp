// The layers of meshes and fields as one mask of the light that is left on their plane, with smooth
// edges (docs/shadows.md#silhouette-masks).
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

// The changes of coverage along the rows of some cells, to be added to a mask of other cells of
// the same size.
class MaskCover {
 private:
  friend class MaskRaster;
  struct Step {
    int u = 0, v = 0;  // from the first cell
    std::array<std::int32_t, 4> front{};
  };
  std::int64_t u_ = 0, v_ = 0;  // the first cell
  std::vector<Step> steps_;
  std::vector<std::array<std::int32_t, 4>> back_;  // one per step, or none
  std::array<std::size_t, 3> sheets_{};            // of each layer, as in MaskRaster
};

class MaskRaster {
 public:
  // Starts with nothing covered.
  void begin(const MaskCells& cells);
  // Covers the layers of a caster projected onto cells of this size: a mesh with these faces and
  // edges, and the faces and outlines given to it. Cells get the same bits as in a larger mask.
  void cover(MaskCaster& caster, std::span<const std::uint32_t> indices,
             std::span<const SharedEdge> edges);
  // Adds a cover that lies within the mask's cells.
  void cover(const MaskCover& cover);
  // Moves all that was covered since begin() to `cover`.
  void take(MaskCover& cover);
  // Writes the share of the (encoded) value that is left in each cell, 0 to 255, rows in order. The
  // darkest layer counts, in part where an edge runs through. `light`: of each layer. Forgets what
  // is covered.
  void finish(const glm::vec3& light, std::vector<std::uint8_t>& codes);
  void finish(const glm::vec3& light, std::span<std::uint8_t> codes);
  // Writes how much of each cell of `part` (of the same size) umbra, middle and penumbra cover, 0
  // to 255, each no less than the one before it; the fourth byte is 0. Forgets what is covered.
  void finish_shares(const MaskCells& part, std::span<std::uint8_t> rgba);

 private:
  using Steps = std::vector<std::array<std::int32_t, 4>>;
  using Place = MaskCaster::Place;  // here from the mask's corner

  // `first`: the place that the caster's places count from.
  void cover_outlines(const MaskCaster& caster, std::span<const SharedEdge> edges,
                      const Place& first);
  void cover_turned(const MaskCaster& caster, std::span<const std::uint32_t> indices,
                    const Place& first);
  void cover_faces(std::span<const Place> places, std::size_t layer, const Place& first);
  void cover_lines(std::span<const Place> places, std::size_t layer, const Place& first);
  void add_face(Steps& to, std::size_t layer, const std::array<Place, 3>& corners);
  // sign -1: as if the edge ran the other way.
  void add_edge(Steps& sums, std::size_t layer, const Place& from, const Place& to, int sign = 1);
  // An edge between borders of the row.
  void add_in_row(Steps& sums, std::size_t layer, int sign, std::int64_t row, const Place& from,
                  const Place& to);
  // Makes room in the sums of a layer for a number of sheets.
  void make_room(std::size_t layer, std::size_t sheets);
  void settle();
  // Sums a row up into changed_ and covered_, and forgets it. Returns the number of changes.
  std::size_t finish_row(std::size_t row);
  // The cell of change i, or the row's end.
  [[nodiscard]] std::ptrdiff_t begin_of(std::size_t i, std::size_t count) const;

  MaskCells cells_;
  // Difference of each cell's covered area from that of the cell before it, per layer; rows have at
  // least one cell more than the mask. Of faces that turn one way, and, where a mesh is given
  // face by face, of the others.
  Steps steps_;
  Steps back_;
  bool has_back_ = false;
  std::array<std::size_t, 3> sheets_{};  // the most that a cell can be covered, per layer
  std::vector<std::uint8_t> touched_;    // 1 for each step that an edge has changed
  std::size_t row_cells_ = 0;            // of all three
  // In one row: the cells that were touched, the area that each layer covers from there on, and
  // their codes.
  std::vector<std::uint32_t> changed_;
  std::array<std::vector<std::int32_t>, 3> covered_;
  std::vector<std::uint8_t> changed_codes_;
};

}  // namespace penumbra
