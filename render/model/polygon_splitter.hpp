// Splits polygons of any outline into triangles.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

class GLUtesselator;

namespace penumbra {

// A corner added where the outline crosses itself.
struct AddedCorner {
  Eigen::Vector3d position;
  // Mean of the polygon's corners, or of corners added before, with these weights.
  std::array<std::uint32_t, 4> of_corners;
  std::array<float, 4> weights;
};

struct PolygonSplit {
  enum class Outcome { split, too_intricate };
  Outcome outcome = Outcome::split;
  // Indices of corners, of added ones from the polygon's corner count on. Oriented as the polygon.
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::vector<AddedCorner> added;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // unit; zero for a polygon without area
  bool crosses_itself = false;  // the triangles' area differs from the polygon's
  bool is_flat = true;          // to 1 % of its radius
};

// Splits polygons into triangles by GLU's tessellator.
//
// The triangles' areas add up to that of a polygon whose outline does not cross itself. It may be
// concave, touch itself, and visit a bridge to a hole twice. An outline that crosses itself is
// filled by the non-zero winding rule. A polygon that is not flat is split as seen along its area
// vector; its corners keep their places. A polygon without area becomes triangles without area.
//
// GLU's time grows with the square of the number of crossings and of edges side by side. A splitter
// limits that work over all of its polygons; those beyond the limit get `too_intricate`.
class PolygonSplitter {
 public:
  PolygonSplitter();
  // GLU's callbacks hold the splitter's address.
  PolygonSplitter(const PolygonSplitter&) = delete;
  PolygonSplitter& operator=(const PolygonSplitter&) = delete;

  // Splits a polygon of three corners or more; `corners` are finite. The result is valid until the
  // next call.
  [[nodiscard]] const PolygonSplit& split(std::span<const Eigen::Vector3d> corners);

 private:
  struct DeleteTessellator {
    void operator()(GLUtesselator* tessellator) const;
  };
  // Computes everything but the triangles.
  void project(std::span<const Eigen::Vector3d> corners);
  [[nodiscard]] Eigen::Vector3d plane_normal() const;
  [[nodiscard]] bool split_quad(std::span<const Eigen::Vector3d> corners);
  void turn_axes(double angle);
  void tessellate();
  [[nodiscard]] double tessellate_soundly();
  [[nodiscard]] void* add_corner(const double* place, void* const* parents, const float* weights);

  std::unique_ptr<GLUtesselator, DeleteTessellator> tessellator_;
  double steps_left_;  // of the limit on GLU's work
  PolygonSplit split_;
  std::size_t corner_count_ = 0;
  // The polygon with its middle at the origin and a radius of 1.
  Eigen::Vector3d middle_ = Eigen::Vector3d::Zero();
  double radius_ = 0.0;
  std::vector<Eigen::Vector3d> scaled_;
  Eigen::Vector3d axis_u_, axis_v_;     // of its plane
  std::vector<Eigen::Vector2d> flat_;   // in its plane; added corners as well
  std::vector<double> heights_;         // over its plane
  std::vector<std::uint32_t> emitted_;  // corners of GLU's triangles
  bool failed_ = false;
};

}  // namespace penumbra
