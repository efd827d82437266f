// Polygon with any outline -> triangles.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

namespace penumbra {

// A corner that the polygon does not have: its outline crosses itself there.
struct AddedCorner {
  Eigen::Vector3d position;
  // Mean of the polygon's corners, or of corners added before, with these weights.
  std::array<std::uint32_t, 4> of_corners;
  std::array<float, 4> weights;
};

struct PolygonSplit {
  enum class Outcome { split, too_intricate };
  Outcome outcome = Outcome::split;
  // Indices of corners; from the polygon's corner count on, of added ones. They turn as the polygon
  // does.
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::vector<AddedCorner> added;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // unit; zero for a polygon without area
  bool crosses_itself = false;                       // the triangles' area differs from its own
  bool is_flat = true;                               // to 1 % of its radius
};

// Splits polygons into triangles by GLU's tessellator.
//
// The triangles' areas add up to that of a polygon whose outline does not cross itself. It may be
// concave, touch itself, and visit a bridge to a hole twice. An outline that crosses itself is
// filled by the non-zero winding rule. A polygon that is not flat is split as seen along its area
// vector; its corners keep their places. A polygon without any area becomes triangles without area.
//
// The work for outlines with many crossings or many edges side by side is limited over all polygons
// of a splitter, as GLU's time grows with the square of their number. Polygons beyond that limit
// get `too_intricate`.
class PolygonSplitter {
 public:
  PolygonSplitter();
  ~PolygonSplitter();
  PolygonSplitter(const PolygonSplitter&) = delete;
  PolygonSplitter& operator=(const PolygonSplitter&) = delete;

  // Splits a polygon of three corners or more; `corners` are finite. The result is valid until the
  // next call.
  [[nodiscard]] const PolygonSplit& split(std::span<const Eigen::Vector3d> corners);

 private:
  struct Work;
  std::unique_ptr<Work> work_;
};

}  // namespace penumbra
