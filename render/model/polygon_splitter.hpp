// Splits polygons of any shape into triangles.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

class GLUtesselator;

namespace penumbra {

// A corner added where the outline intersects itself.
struct AddedCorner {
  Eigen::Vector3d position;
  // The corner is the weighted mean of these corners (the polygon's, or added earlier).
  std::array<std::uint32_t, 4> of_corners;
  std::array<float, 4> weights;
};

struct PolygonSplit {
  enum class Outcome { split, too_intricate };
  Outcome outcome = Outcome::split;
  // Corner indices, oriented like the polygon. Indices from its corner count on refer to `added`.
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::vector<AddedCorner> added;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // unit; zero for a polygon without area
  bool crosses_itself = false;  // the triangles' area differs from the polygon's
  bool is_flat = true;          // no corner is farther from the plane than 1 % of the radius
};

// Splits polygons into triangles by GLU's tessellator.
//
// Outlines may be concave, touch themselves, and traverse a bridge to a hole twice; the triangles'
// areas then sum to the polygon's area. Self-intersecting outlines are filled by the non-zero
// winding rule. A non-planar polygon is projected along its area vector for splitting; its corners
// keep their positions. A polygon of zero area gives triangles of zero area.
//
// GLU's time is quadratic in the number of intersections and of parallel edges. A splitter limits
// that work over all of its polygons; polygons beyond the limit get `too_intricate`.
class PolygonSplitter {
 public:
  PolygonSplitter();
  // Not copyable: GLU's callbacks hold the splitter's address.
  PolygonSplitter(const PolygonSplitter&) = delete;
  PolygonSplitter& operator=(const PolygonSplitter&) = delete;

  // Splits a polygon of three or more finite corners. The result is valid until the next call.
  [[nodiscard]] const PolygonSplit& split(std::span<const Eigen::Vector3d> corners);

 private:
  struct DeleteTessellator {
    void operator()(GLUtesselator* tessellator) const;
  };
  // Projects the corners onto the polygon's plane. Sets the normal and `is_flat`.
  void project(std::span<const Eigen::Vector3d> corners);
  [[nodiscard]] Eigen::Vector3d plane_normal() const;
  [[nodiscard]] bool split_quad(std::span<const Eigen::Vector3d> corners);
  void rotate_axes(double angle);
  void tessellate();
  [[nodiscard]] double tessellate_with_retries();
  [[nodiscard]] void* add_corner(const double* place, void* const* parents, const float* weights);

  std::unique_ptr<GLUtesselator, DeleteTessellator> tessellator_;
  double steps_left_;  // remaining limit of GLU's work
  PolygonSplit split_;
  std::size_t corner_count_ = 0;
  // The polygon with its middle at the origin and a radius of 1.
  Eigen::Vector3d middle_ = Eigen::Vector3d::Zero();
  double radius_ = 0.0;
  std::vector<Eigen::Vector3d> scaled_;
  Eigen::Vector3d axis_u_, axis_v_;     // axes in the polygon's plane
  std::vector<Eigen::Vector2d> flat_;   // corners in these axes, then added corners
  std::vector<double> heights_;         // heights of these corners above the plane
  std::vector<std::uint32_t> emitted_;  // corners of GLU's triangles
  bool failed_ = false;
};

}  // namespace penumbra
