// The layers of closed meshes, and of fields, as one picture of the light that is left on their
// plane, with smooth edges. Of a closed mesh's image on a plane, whatever moved its vertices there,
// as many faces turn one way as the other over any point; so those that turn one way cover all of
// it, and the area under them is told by the edges where they meet the others (silhouettes), cell
// by cell, exactly. Where a mesh is open or cut, neither those that turn one way nor the others
// need cover all of it, but both together do: each kind is summed by itself, and the greater sum
// counts. Neighbours that turn the same way cancel out along their edge, and where two that turn
// different ways meet, the surface folds: both cover the same side.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <type_traits>
#include <vector>

#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/layers/own_frame.hpp"
#include "render/shadow/masks/mask_layout.hpp"
#include "render/shadow/masks/mesh_edges.hpp"

namespace penumbra {

// One mesh over the plane. Kept between frames for its memory.
class MaskCaster {
 public:
  // Nothing of it, on cells of this size. project() begins by itself.
  void begin(const OwnFrame& own, double cell);
  // Triangles of a layer in the own frame [m], three points each, of a mesh whose edges are paired
  // or of oriented faces, cut or not: all that casts the layer, in place of what project() would.
  // Nothing of those that are not finite; places are taken to be at most 2 million cells from the
  // object's origin.
  void project_faces(ShadowLayer layer, std::span<const PlanePoint> triangles);
  // Closed lines in the own frame [m], the layer to the left of each side: all that is of the
  // layer.
  void project_outline(ShadowLayer layer, std::span<const OutlineSide> sides);
  // Vertices and kernels in the object's frame [m], one each; what `wanted` says of the layers is
  // to be covered, and all of the mesh is in their heights. Places in cells of this size are
  // rounded to 1/256 of one (where a float can tell it), and taken as those of project_faces().
  void project(std::span<const glm::vec3> positions, std::span<const glm::vec3> kernels,
               const OwnFrame& own, const LayeredConstants& constants,
               const std::array<bool, 3>& wanted, double cell);
  // Of all layers, in cells; empty where none is wanted.
  [[nodiscard]] const Eigen::AlignedBox<std::int64_t, 2>& bounds() const { return bounds_; }

 private:
  friend class MaskPicture;
  // 1/256 cells from the whole cell that the object's origin is over, whole numbers: (u, v) of each
  // layer; of wanted layers either finite or both not numbers.
  struct Images {
    alignas(16) std::array<float, 4> u;
    alignas(16) std::array<float, 4> v;
  };
  void bring_near();
  std::vector<Images> images_;
  std::array<bool, 3> wanted_{};
  std::int64_t first_u_ = 0, first_v_ = 0;  // that cell
  Eigen::AlignedBox<std::int64_t, 2> bounds_;
  std::vector<std::uint8_t> turned_;  // of each face, a bit for each layer
  PlanarMotion T_plane_own_;
  double cell_ = 0.0;
  // Of layers that were given face by face; (u, v) in places as above.
  using Place = Eigen::Vector<std::int64_t, 2>;
  std::array<std::vector<Place>, 3> faces_;
  std::array<std::vector<Place>, 3> sides_;  // two points each
  [[nodiscard]] std::optional<Place> place_of(const PlanePoint& p) const;
  void extend_bounds(const Place& place);
};

// What covers cells, by rows and wherever it changes along them; to be covered again in a picture
// of other cells of the same size.
class MaskCover {
 private:
  friend class MaskPicture;
  struct Step {
    int u = 0, v = 0;  // from the first cell
    std::array<std::int32_t, 4> front{};
  };
  std::int64_t u_ = 0, v_ = 0;  // the first cell
  std::vector<Step> steps_;
  std::vector<std::array<std::int32_t, 4>> back_;  // as many, or none
  std::array<std::size_t, 3> sheets_{};            // of each layer, as in MaskPicture
};

class MaskPicture {
 public:
  // Nothing covered.
  void begin(const MaskCells& cells);
  // Faces as `caster` was projected with, of cells of this size. Of what reaches beyond the
  // picture, its cells get what a larger picture would have there, bit by bit.
  void cover(MaskCaster& caster, std::span<const std::uint32_t> indices,
             std::span<const FacePair> edges);
  // Adds what take() took, all of which lies within the picture's cells.
  void cover(const MaskCover& cover);
  // All that was covered since begin(), and forgets it.
  void take(MaskCover& cover);
  // What is left of the picture's (encoded) value in each cell, 0 to 255, rows in order: that of
  // the darkest layer there, in part where an edge runs through. `light`: of each layer. What is
  // covered is forgotten.
  void finish(const glm::vec3& light, std::vector<std::uint8_t>& codes);
  // The same into as many codes as the picture has cells.
  void finish(const glm::vec3& light, std::span<std::uint8_t> codes);
  // How much of each of these cells, of the same size, umbra, middle and penumbra cover, 0 to 255,
  // each no less than the one before it; 4 bytes each, the last one 0, rows in order. What is
  // covered is forgotten, of all cells.
  void finish_shares(const MaskCells& part, std::span<std::uint8_t> rgba);

 private:
  using Steps = std::vector<std::array<std::int32_t, 4>>;
  // Places in 1/256 cells from the first cell's corner; of add_in_row() `v` from the row's border,
  // and the row by its first cell. kSign -1: as if it ran the other way.
  template <int kSign = 1>
  void add_edge(Steps& to, int layer, int u0, int v0, int u1, int v1);
  template <int kSign>
  void add_in_row(Steps& sums, int layer, std::ptrdiff_t begin, int u0, int v0, int u1, int v1);
  // The same of what of it lies in the picture, and of what lies to the left of that.
  template <int kSign = 1>
  void add_clipped_edge(Steps& to, int layer, std::int64_t u0, std::int64_t v0, std::int64_t u1,
                        std::int64_t v1);
  template <int kSign>
  void add_clipped_in_row(Steps& sums, int layer, std::ptrdiff_t begin, std::int64_t u0, int v0,
                          std::int64_t u1, int v1);
  template <bool kClipped>
  void cover_outlines(const MaskCaster& caster, std::span<const FacePair> edges);
  template <bool kClipped>
  void cover_turned(const MaskCaster& caster, std::span<const std::uint32_t> indices);
  template <bool kClipped>
  void cover_faces(const MaskCaster& caster, int layer);
  template <bool kClipped>
  void cover_lines(const MaskCaster& caster, int layer);
  // In the picture all places fit into 32 bits.
  template <bool kClipped>
  using Offset = std::conditional_t<kClipped, std::int64_t, int>;
  template <bool kClipped>
  struct Place {
    Offset<kClipped> u, v;
  };
  template <bool kClipped>
  void add_face(Steps& to, int layer, const std::array<Place<kClipped>, 3>& corners);
  // Room in the sums of a layer for so many sheets more.
  void make_room(int layer, std::size_t sheets);
  void settle();
  void begin_rows();
  // Where the shares change along a row into changed_, what they are from there into covered_;
  // forgets the row. How often.
  std::size_t finish_row(std::size_t row);
  template <bool kBack>
  std::size_t gather_row(std::size_t row);

  MaskCells cells_;
  // By how much the covered share of a cell differs from that of the one before it in its row, in
  // 1/kWhole, for each layer; at least one cell more than the row has. Under faces that turn one
  // way; and, where a mesh is given face by face, the other.
  Steps steps_;
  Steps back_;
  bool has_back_ = false;
  // How often a cell is covered at most, by each layer, in sums as they are.
  std::array<std::size_t, 3> sheets_{};
  std::vector<std::uint8_t> touched_;  // 1 for each of these that an edge has changed
  std::size_t row_cells_ = 0;          // of all three
  // Of one row: the cells that were touched, what is covered of them by each layer, and their
  // codes.
  std::vector<std::uint32_t> changed_;
  std::array<std::vector<std::int32_t>, 3> covered_;
  std::vector<std::uint8_t> changed_codes_;
};

}  // namespace penumbra
