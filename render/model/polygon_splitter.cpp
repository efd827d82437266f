#include "render/model/polygon_splitter.hpp"

#include <GL/glu.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <new>
#include <numeric>

#include "core/assert.hpp"

namespace penumbra {
namespace {

constexpr double kMaxSweepSteps = 6e7;     // limit of sweep_steps() over all polygons; about 2 s
constexpr double kOrdinarySteps = 10.0;    // steps per corner
constexpr double kStepsOfCrossing = 30.0;  // steps per intersection, which adds a corner
constexpr double kStepsOfCut = 0.2;        // steps per pair of a reflex corner and a corner
// Positions closer than this [radii] count as equal: rounding may move a corner across an edge.
constexpr double kSamePlace = 1e-9;
constexpr double kFlatShare = 0.01;      // maximum height of a flat polygon's corners [radii]
constexpr double kAreaTolerance = 1e-6;  // fraction of the area
constexpr int kMaxAttempts = 5;
constexpr double kAttemptAngle = 1.0;      // [rad] between attempts
constexpr double kMinAreaFraction = 1e-9;  // |sum of areas| / sum of |areas|; below, areas cancel
constexpr double kNoArea = 1e-14;          // areas up to this are zero [squared radii]
constexpr double kRoundedArea = 1e-12;     // rounding error of areas [squared radii]

double cross_2d(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}
double doubled_area(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c) {
  return cross_2d(b - a, c - a);
}

// Returns true if the edges intersect other than at a common end, or overlap from a common end.
bool edges_meet(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c,
                const Eigen::Vector2d& d) {
  if (a == b || c == d || (a == c && b == d) || (a == d && b == c)) return false;
  if (b == c || b == d) return edges_meet(b, a, c, d);
  if (a == d) return edges_meet(a, b, d, c);
  if (a == c) {
    const Eigen::Vector2d ab = b - a;
    const Eigen::Vector2d ad = d - a;
    return ab.dot(ad) > 0.0 && std::abs(cross_2d(ab, ad)) <= kSamePlace * ab.norm() * ad.norm();
  }
  if (std::max(a.y(), b.y()) < std::min(c.y(), d.y()) ||
      std::max(c.y(), d.y()) < std::min(a.y(), b.y())) {
    return false;
  }
  return doubled_area(a, b, c) * doubled_area(a, b, d) <= 0.0 &&
         doubled_area(c, d, a) * doubled_area(c, d, b) <= 0.0;
}

// Estimates GLU's steps beyond those of an ordinary outline: GLU walks the list of active edges at
// each corner and intersection, and a whole outline at each reflex corner. Stops counting beyond
// `limit`.
double sweep_steps(std::span<const Eigen::Vector2d> corners, double limit) {
  const std::size_t count = corners.size();
  double reflex = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto& next = corners[(i + 1) % count];
    reflex += doubled_area(corners[i], next, corners[(i + 2) % count]) < 0.0 ? 1.0 : 0.0;
  }
  const double cuts = kStepsOfCut * reflex * static_cast<double>(count);
  const auto end_of = [&](std::size_t edge) -> const Eigen::Vector2d& {
    return corners[(edge + 1) % count];
  };
  std::vector<std::uint32_t> order(count);
  std::iota(order.begin(), order.end(), 0U);
  const auto left = [&](std::size_t edge) { return std::min(corners[edge].x(), end_of(edge).x()); };
  std::sort(order.begin(), order.end(),
            [&](std::uint32_t a, std::uint32_t b) { return left(a) < left(b); });
  const auto ordinary = kOrdinarySteps * static_cast<double>(count);
  std::vector<std::uint32_t> active;
  double walked = 0.0;
  double crossings = 0.0;
  const auto beyond_ordinary = [&] {
    return (1.0 + crossings / static_cast<double>(count)) * walked + kStepsOfCrossing * crossings +
           cuts - ordinary;
  };
  for (const std::uint32_t edge : order) {
    const double x = left(edge);
    std::erase_if(active, [&](std::uint32_t other) {
      return std::max(corners[other].x(), end_of(other).x()) < x;
    });
    walked += static_cast<double>(active.size());
    for (const std::uint32_t other : active) {
      crossings += edges_meet(corners[edge], end_of(edge), corners[other], end_of(other)) ? 1 : 0;
    }
    if (beyond_ordinary() > limit) break;
    active.push_back(edge);
  }
  return std::max(0.0, beyond_ordinary());
}

// GLU passes corners as pointers: index + 1, because null means none.
void* to_handle(std::size_t index) {
  return reinterpret_cast<void*>(index + 1);  // NOLINT(performance-no-int-to-ptr)
}
std::uint32_t from_handle(const void* handle) {
  return static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(handle) - 1);
}

}  // namespace

void PolygonSplitter::DeleteTessellator::operator()(GLUtesselator* tessellator) const {
  gluDeleteTess(tessellator);
}

void PolygonSplitter::project(std::span<const Eigen::Vector3d> corners) {
  corner_count_ = corners.size();
  // The mean lies in the plane. Relative to the first corner, it is accurate far from the origin.
  middle_.setZero();
  for (const Eigen::Vector3d& corner : corners) {
    middle_ += (corner - corners[0]) / static_cast<double>(corner_count_);
  }
  middle_ += corners[0];
  radius_ = 0.0;
  for (const Eigen::Vector3d& corner : corners) {
    radius_ = std::max(radius_, (corner - middle_).stableNorm());
  }
  scaled_.clear();
  for (const Eigen::Vector3d& corner : corners) {
    scaled_.push_back(radius_ > 0.0 ? Eigen::Vector3d((corner - middle_) / radius_)
                                    : Eigen::Vector3d::Zero());
  }
  split_ = {};
  flat_.clear();
  heights_.clear();
  emitted_.clear();
  failed_ = false;
  split_.normal = plane_normal();
  if (split_.normal.isZero(0.0)) return;
  axis_u_ = split_.normal.unitOrthogonal();
  axis_v_ = split_.normal.cross(axis_u_);
  Eigen::Vector2d length = Eigen::Vector2d::Zero();
  Eigen::AlignedBox2d extent;
  for (const Eigen::Vector3d& p : scaled_) {
    heights_.push_back(split_.normal.dot(p));
    flat_.emplace_back(axis_u_.dot(p), axis_v_.dot(p));
    extent.extend(flat_.back());
    if (std::abs(heights_.back()) > kFlatShare) split_.is_flat = false;
  }
  for (std::size_t i = 0; i < flat_.size(); ++i) {
    length += (flat_[(i + 1) % flat_.size()] - flat_[i]).cwiseAbs();
  }
  // GLU sweeps along u, so the axes are swapped if a sweep along v has fewer active edges.
  if (length.y() * extent.sizes().x() < length.x() * extent.sizes().y()) {
    const Eigen::Vector3d u = axis_u_;
    axis_u_ = axis_v_;
    axis_v_ = -u;
    for (Eigen::Vector2d& p : flat_) p = Eigen::Vector2d(p.y(), -p.x());
  }
}

// Returns the direction of the area vector (Newell's method) or, if areas cancel, the normal of the
// largest triangle between an edge and the middle. Zero for a polygon of zero area.
Eigen::Vector3d PolygonSplitter::plane_normal() const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Vector3d largest = Eigen::Vector3d::Zero();
  double total = 0.0;
  for (std::size_t i = 0; i < scaled_.size(); ++i) {
    const Eigen::Vector3d term = scaled_[i].cross(scaled_[(i + 1) % scaled_.size()]);
    sum += term;
    total += term.norm();
    if (term.squaredNorm() > largest.squaredNorm()) largest = term;
  }
  if (!(largest.norm() > kNoArea)) return Eigen::Vector3d::Zero();
  return (sum.norm() > kMinAreaFraction * total ? sum : largest).normalized();
}

// Splits a quadrilateral along its shorter inner diagonal. Returns false if no diagonal is inside,
// as for a self-intersecting outline.
bool PolygonSplitter::split_quad(std::span<const Eigen::Vector3d> corners) {
  const auto squared_length = [&](std::size_t a, std::size_t b) {
    const Eigen::Vector3f d = corners[b].cast<float>() - corners[a].cast<float>();
    return d.x() * d.x() + d.y() * d.y() + d.z() * d.z();
  };
  using Triangles = std::array<std::array<std::uint32_t, 3>, 2>;
  Triangles first = {{{0, 1, 2}, {0, 2, 3}}};
  Triangles second = {{{0, 1, 3}, {1, 2, 3}}};
  if (!(squared_length(0, 2) < squared_length(1, 3))) std::swap(first, second);
  const auto accept = [&](const Triangles& triangles) {
    split_.triangles.assign(triangles.begin(), triangles.end());
    return true;
  };
  if (flat_.empty()) return accept(first);
  const auto is_inside = [&](const Triangles& triangles) {
    return std::ranges::all_of(triangles, [&](const std::array<std::uint32_t, 3>& t) {
      return doubled_area(flat_[t[0]], flat_[t[1]], flat_[t[2]]) >= 0.0;
    });
  };
  if (is_inside(first)) return accept(first);
  return is_inside(second) && accept(second);
}

// Returns the handle of the corner, existing or added, for an intersection found by GLU.
void* PolygonSplitter::add_corner(const GLdouble* place, void* const* parents,
                                  const GLfloat* weights) {
  // Two corners coincide.
  if (parents[2] == nullptr || parents[3] == nullptr) return parents[0];
  const Eigen::Vector2d p(place[0], place[1]);
  AddedCorner corner{};
  double height = 0.0;
  for (std::size_t i = 0; i < 4; ++i) {
    const std::uint32_t parent = from_handle(parents[i]);
    if ((flat_[parent] - p).norm() < kSamePlace) return parents[i];
    corner.of_corners[i] = parent;
    corner.weights[i] = weights[i];
    height += static_cast<double>(weights[i]) * heights_[parent];
  }
  corner.position =
      middle_ + radius_ * (p.x() * axis_u_ + p.y() * axis_v_ + height * split_.normal);
  split_.added.push_back(corner);
  flat_.push_back(p);
  heights_.push_back(height);
  return to_handle(flat_.size() - 1);
}

// Rotates the axes in the polygon's plane, and thus the direction of GLU's sweep.
void PolygonSplitter::rotate_axes(double angle) {
  const Eigen::Matrix2d turn = Eigen::Rotation2Dd(-angle).toRotationMatrix();
  for (Eigen::Vector2d& p : flat_) p = turn * p;
  const Eigen::Vector3d u = axis_u_;
  axis_u_ = turn(0, 0) * u + turn(0, 1) * axis_v_;
  axis_v_ = turn(1, 0) * u + turn(1, 1) * axis_v_;
}

void PolygonSplitter::tessellate() {
  split_.triangles.clear();
  split_.added.clear();
  emitted_.clear();
  flat_.resize(corner_count_);
  heights_.resize(corner_count_);
  GLUtesselator* glu = tessellator_.get();
  gluTessBeginPolygon(glu, this);
  gluTessBeginContour(glu);
  for (std::size_t i = 0; i < corner_count_; ++i) {
    std::array<GLdouble, 3> place = {flat_[i].x(), flat_[i].y(), 0.0};
    gluTessVertex(glu, place.data(), to_handle(i));
  }
  gluTessEndContour(glu);
  gluTessEndPolygon(glu);
  for (std::size_t i = 0; i + 2 < emitted_.size(); i += 3) {
    const std::array<std::uint32_t, 3> t = {emitted_[i], emitted_[i + 1], emitted_[i + 2]};
    if (t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) split_.triangles.push_back(t);
  }
}

// Returns the number of attempts. If edges coincide up to rounding, as along a bridge to a hole,
// GLU may lose or fold areas, so other sweep directions are tried. Accepts a result if its area
// equals the outline's area or the area of the previous attempt.
double PolygonSplitter::tessellate_with_retries() {
  double before = -1.0;
  for (int attempt = 1;; ++attempt) {
    tessellate();
    double outline_area = 0.0;
    for (std::size_t i = 0; i < corner_count_; ++i) {
      outline_area += cross_2d(flat_[i], flat_[(i + 1) % corner_count_]);
    }
    double covered = 0.0;
    double folded = 0.0;
    for (const auto& t : split_.triangles) {
      const double area = doubled_area(flat_[t[0]], flat_[t[1]], flat_[t[2]]);
      covered += area;
      folded -= std::min(area, 0.0);
    }
    const double tolerance =
        kRoundedArea + kAreaTolerance * std::max(std::abs(outline_area), std::abs(covered));
    split_.crosses_itself = std::abs(covered - outline_area) > tolerance;
    const bool sound =
        folded <= tolerance && (!split_.crosses_itself || std::abs(covered - before) <= tolerance);
    if (sound || failed_ || attempt == kMaxAttempts) return attempt;
    before = covered;
    rotate_axes(kAttemptAngle);
  }
}

PolygonSplitter::PolygonSplitter() : tessellator_(gluNewTess()), steps_left_(kMaxSweepSteps) {
  GLUtesselator* glu = tessellator_.get();
  if (glu == nullptr) throw std::bad_alloc();
  const auto vertex = [](void* handle, void* self) {
    static_cast<PolygonSplitter*>(self)->emitted_.push_back(from_handle(handle));
  };
  // Setting an edge flag callback makes GLU emit separate triangles.
  const auto edge_flag = [](GLboolean, void*) {};
  const auto combine = [](GLdouble* place, void** parents, GLfloat* weights, void** corner,
                          void* self) {
    *corner = static_cast<PolygonSplitter*>(self)->add_corner(place, parents, weights);
  };
  const auto error = [](GLenum, void* self) {
    static_cast<PolygonSplitter*>(self)->failed_ = true;
  };
  const auto set = [glu](GLenum which, auto* callback) {
    gluTessCallback(glu, which, reinterpret_cast<_GLUfuncptr>(callback));
  };
  set(GLU_TESS_VERTEX_DATA, +vertex);
  set(GLU_TESS_EDGE_FLAG_DATA, +edge_flag);
  set(GLU_TESS_COMBINE_DATA, +combine);
  set(GLU_TESS_ERROR_DATA, +error);
  gluTessProperty(glu, GLU_TESS_WINDING_RULE, GLU_TESS_WINDING_NONZERO);
  gluTessNormal(glu, 0.0, 0.0, 1.0);
}

const PolygonSplit& PolygonSplitter::split(std::span<const Eigen::Vector3d> corners) {
  PENUMBRA_ASSERT(corners.size() >= 3);
  project(corners);
  const auto count = static_cast<std::uint32_t>(corners.size());
  if (count == 4 && split_quad(corners)) return split_;
  if (count == 3 || flat_.empty()) {
    for (std::uint32_t i = 1; i + 1 < count; ++i) split_.triangles.push_back({0, i, i + 1});
    return split_;
  }
  const double steps = sweep_steps(flat_, steps_left_);
  if (steps > steps_left_) {
    split_.outcome = PolygonSplit::Outcome::too_intricate;
    return split_;
  }
  steps_left_ -= steps * tessellate_with_retries();
  if (failed_) split_.outcome = PolygonSplit::Outcome::too_intricate;
  return split_;
}

}  // namespace penumbra
