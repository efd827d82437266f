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

// Steps of GLU's sweep beyond those of an ordinary outline; about 2 s.
constexpr double kMaxSweepSteps = 6e7;
constexpr double kOrdinarySteps = 10.0;    // per corner
constexpr double kStepsOfCrossing = 30.0;  // to make the new corner
constexpr double kStepsOfCut = 0.2;  // per corner of the face that a reflex corner cuts in two
// Places closer than this share of the polygon's radius are one. Rounding makes corners that touch
// an edge cross it by less.
constexpr double kSamePlace = 1e-9;
constexpr double kFlatShare = 0.01;      // of the radius that a corner may be off the plane
constexpr double kAreaTolerance = 1e-6;  // share of the area
constexpr int kMaxAttempts = 5;
constexpr double kAttemptAngle = 1.0;     // [rad] between attempts
constexpr double kLeastAreaShare = 1e-9;  // below, areas that turn both ways cancel each other
constexpr double kNoArea = 1e-14;         // of the squared radius
constexpr double kRoundedArea = 1e-12;    // of the squared radius

double cross_2d(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}
double doubled_area(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c) {
  return cross_2d(b - a, c - a);
}

// Returns true for edges that meet anywhere but at an end that they share, and for edges that go
// from such an end in the same direction.
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

// Estimates GLU's steps beyond an ordinary outline's: at each corner and each crossing it walks
// through a list of the edges side by side there, and at each reflex corner along a whole outline.
// Stops counting beyond `limit`.
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
  std::vector<std::uint32_t> side_by_side;
  double walked = 0.0;
  double crossings = 0.0;
  const auto beyond_ordinary = [&] {
    return (1.0 + crossings / static_cast<double>(count)) * walked + kStepsOfCrossing * crossings +
           cuts - ordinary;
  };
  for (const std::uint32_t edge : order) {
    const double x = left(edge);
    std::erase_if(side_by_side, [&](std::uint32_t other) {
      return std::max(corners[other].x(), end_of(other).x()) < x;
    });
    walked += static_cast<double>(side_by_side.size());
    for (const std::uint32_t other : side_by_side) {
      crossings += edges_meet(corners[edge], end_of(edge), corners[other], end_of(other)) ? 1 : 0;
    }
    if (beyond_ordinary() > limit) break;
    side_by_side.push_back(edge);
  }
  return std::max(0.0, beyond_ordinary());
}

}  // namespace

struct PolygonSplitter::Work {
  struct DeleteTessellator {
    void operator()(GLUtesselator* tessellator) const { gluDeleteTess(tessellator); }
  };

  void project(std::span<const Eigen::Vector3d> corners);
  [[nodiscard]] Eigen::Vector3d plane_normal() const;
  [[nodiscard]] bool split_quad(std::span<const Eigen::Vector3d> corners);
  void turn_axes(double angle);
  void tessellate();
  [[nodiscard]] double tessellate_soundly();
  [[nodiscard]] void* add_corner(const GLdouble* place, void* const* parents,
                                 const GLfloat* weights);

  std::unique_ptr<GLUtesselator, DeleteTessellator> tessellator{gluNewTess()};
  double steps_left = kMaxSweepSteps;
  PolygonSplit split;
  std::size_t corner_count = 0;
  // The polygon with its middle at the origin and a radius of 1.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double radius = 0.0;
  std::vector<Eigen::Vector3d> scaled;
  Eigen::Vector3d axis_u, axis_v;      // of its plane
  std::vector<Eigen::Vector2d> flat;   // in its plane; added corners as well
  std::vector<double> heights;         // over its plane
  std::vector<std::uint32_t> emitted;  // corners of GLU's triangles
  bool failed = false;
};

namespace {

// GLU hands each corner on as a pointer: its index + 1, as null means none.
void* to_handle(std::size_t index) {
  return reinterpret_cast<void*>(index + 1);  // NOLINT(performance-no-int-to-ptr)
}
std::uint32_t from_handle(const void* handle) {
  return static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(handle) - 1);
}

}  // namespace

// Fills in everything but the triangles.
void PolygonSplitter::Work::project(std::span<const Eigen::Vector3d> corners) {
  corner_count = corners.size();
  // The mean lies in the plane. Taken from the first corner, a polygon far away costs no digits.
  middle.setZero();
  for (const Eigen::Vector3d& corner : corners) {
    middle += (corner - corners[0]) / static_cast<double>(corner_count);
  }
  middle += corners[0];
  radius = 0.0;
  for (const Eigen::Vector3d& corner : corners) {
    radius = std::max(radius, (corner - middle).stableNorm());
  }
  scaled.clear();
  for (const Eigen::Vector3d& corner : corners) {
    scaled.push_back(radius > 0.0 ? Eigen::Vector3d((corner - middle) / radius)
                                  : Eigen::Vector3d::Zero());
  }
  split = {};
  flat.clear();
  heights.clear();
  emitted.clear();
  failed = false;
  split.normal = plane_normal();
  if (split.normal.isZero(0.0)) return;
  axis_u = split.normal.unitOrthogonal();
  axis_v = split.normal.cross(axis_u);
  Eigen::Vector2d length = Eigen::Vector2d::Zero();
  Eigen::AlignedBox2d extent;
  for (const Eigen::Vector3d& p : scaled) {
    heights.push_back(split.normal.dot(p));
    flat.emplace_back(axis_u.dot(p), axis_v.dot(p));
    extent.extend(flat.back());
    if (std::abs(heights.back()) > kFlatShare) split.is_flat = false;
  }
  for (std::size_t i = 0; i < flat.size(); ++i) {
    length += (flat[(i + 1) % flat.size()] - flat[i]).cwiseAbs();
  }
  // GLU sweeps along u: the other way where fewer edges lie side by side there.
  if (length.y() * extent.sizes().x() < length.x() * extent.sizes().y()) {
    const Eigen::Vector3d u = axis_u;
    axis_u = axis_v;
    axis_v = -u;
    for (Eigen::Vector2d& p : flat) p = Eigen::Vector2d(p.y(), -p.x());
  }
}

// Direction of the area vector (Newell's method), or of the largest triangle with the middle where
// the areas cancel each other. Zero for a polygon without any area.
Eigen::Vector3d PolygonSplitter::Work::plane_normal() const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Vector3d largest = Eigen::Vector3d::Zero();
  double total = 0.0;
  for (std::size_t i = 0; i < scaled.size(); ++i) {
    const Eigen::Vector3d term = scaled[i].cross(scaled[(i + 1) % scaled.size()]);
    sum += term;
    total += term.norm();
    if (term.squaredNorm() > largest.squaredNorm()) largest = term;
  }
  if (!(largest.norm() > kNoArea)) return Eigen::Vector3d::Zero();
  return (sum.norm() > kLeastAreaShare * total ? sum : largest).normalized();
}

// Splits a polygon of four corners along its shorter diagonal that lies inside. Fails where none
// does: its outline crosses itself.
bool PolygonSplitter::Work::split_quad(std::span<const Eigen::Vector3d> corners) {
  const auto squared_length = [&](std::size_t a, std::size_t b) {
    const Eigen::Vector3f d = corners[b].cast<float>() - corners[a].cast<float>();
    return d.x() * d.x() + d.y() * d.y() + d.z() * d.z();
  };
  using Triangles = std::array<std::array<std::uint32_t, 3>, 2>;
  Triangles first = {{{0, 1, 2}, {0, 2, 3}}};
  Triangles second = {{{0, 1, 3}, {1, 2, 3}}};
  if (!(squared_length(0, 2) < squared_length(1, 3))) std::swap(first, second);
  const auto take = [&](const Triangles& triangles) {
    split.triangles.assign(triangles.begin(), triangles.end());
    return true;
  };
  if (flat.empty()) return take(first);
  const auto is_inside = [&](const Triangles& triangles) {
    return std::ranges::all_of(triangles, [&](const std::array<std::uint32_t, 3>& t) {
      return doubled_area(flat[t[0]], flat[t[1]], flat[t[2]]) >= 0.0;
    });
  };
  if (is_inside(first)) return take(first);
  return is_inside(second) && take(second);
}

// Returns the handle of a corner for a place where GLU lets edges meet: a corner that is there, or
// an added one.
void* PolygonSplitter::Work::add_corner(const GLdouble* place, void* const* parents,
                                        const GLfloat* weights) {
  // Two corners at one place.
  if (parents[2] == nullptr || parents[3] == nullptr) return parents[0];
  const Eigen::Vector2d p(place[0], place[1]);
  AddedCorner corner{};
  double height = 0.0;
  for (std::size_t i = 0; i < 4; ++i) {
    const std::uint32_t parent = from_handle(parents[i]);
    if ((flat[parent] - p).norm() < kSamePlace) return parents[i];
    corner.of_corners[i] = parent;
    corner.weights[i] = weights[i];
    height += static_cast<double>(weights[i]) * heights[parent];
  }
  corner.position = middle + radius * (p.x() * axis_u + p.y() * axis_v + height * split.normal);
  split.added.push_back(corner);
  flat.push_back(p);
  heights.push_back(height);
  return to_handle(flat.size() - 1);
}

// Turns the axes within the polygon's plane. GLU sweeps along u.
void PolygonSplitter::Work::turn_axes(double angle) {
  const Eigen::Matrix2d turn = Eigen::Rotation2Dd(-angle).toRotationMatrix();
  for (Eigen::Vector2d& p : flat) p = turn * p;
  const Eigen::Vector3d u = axis_u;
  axis_u = turn(0, 0) * u + turn(0, 1) * axis_v;
  axis_v = turn(1, 0) * u + turn(1, 1) * axis_v;
}

void PolygonSplitter::Work::tessellate() {
  split.triangles.clear();
  split.added.clear();
  emitted.clear();
  flat.resize(corner_count);
  heights.resize(corner_count);
  GLUtesselator* glu = tessellator.get();
  gluTessBeginPolygon(glu, this);
  gluTessBeginContour(glu);
  for (std::size_t i = 0; i < corner_count; ++i) {
    std::array<GLdouble, 3> place = {flat[i].x(), flat[i].y(), 0.0};
    gluTessVertex(glu, place.data(), to_handle(i));
  }
  gluTessEndContour(glu);
  gluTessEndPolygon(glu);
  for (std::size_t i = 0; i + 2 < emitted.size(); i += 3) {
    const std::array<std::uint32_t, 3> t = {emitted[i], emitted[i + 1], emitted[i + 2]};
    if (t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) split.triangles.push_back(t);
  }
}

// Returns the number of attempts. GLU may lose or fold areas where edges lie within rounding of
// each other, as along a bridge to a hole, and does not in other directions of its sweep. So a
// result counts that has the outline's area, or that comes out twice.
double PolygonSplitter::Work::tessellate_soundly() {
  double before = -1.0;
  for (int attempt = 1;; ++attempt) {
    tessellate();
    double own = 0.0;
    for (std::size_t i = 0; i < corner_count; ++i) {
      own += cross_2d(flat[i], flat[(i + 1) % corner_count]);
    }
    double covered = 0.0;
    double folded = 0.0;
    for (const auto& t : split.triangles) {
      const double area = doubled_area(flat[t[0]], flat[t[1]], flat[t[2]]);
      covered += area;
      folded -= std::min(area, 0.0);
    }
    const double tolerance =
        kRoundedArea + kAreaTolerance * std::max(std::abs(own), std::abs(covered));
    split.crosses_itself = std::abs(covered - own) > tolerance;
    const bool sound =
        folded <= tolerance && (!split.crosses_itself || std::abs(covered - before) <= tolerance);
    if (sound || failed || attempt == kMaxAttempts) return attempt;
    before = covered;
    turn_axes(kAttemptAngle);
  }
}

PolygonSplitter::PolygonSplitter() : work_(std::make_unique<Work>()) {
  GLUtesselator* glu = work_->tessellator.get();
  if (glu == nullptr) throw std::bad_alloc();
  const auto vertex = [](void* handle, void* work) {
    static_cast<Work*>(work)->emitted.push_back(from_handle(handle));
  };
  // GLU gives separate triangles where someone listens to edge flags.
  const auto edge_flag = [](GLboolean, void*) {};
  const auto combine = [](GLdouble* place, void** parents, GLfloat* weights, void** corner,
                          void* work) {
    *corner = static_cast<Work*>(work)->add_corner(place, parents, weights);
  };
  const auto error = [](GLenum, void* work) { static_cast<Work*>(work)->failed = true; };
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

PolygonSplitter::~PolygonSplitter() = default;

const PolygonSplit& PolygonSplitter::split(std::span<const Eigen::Vector3d> corners) {
  PENUMBRA_ASSERT(corners.size() >= 3);
  Work& work = *work_;
  work.project(corners);
  PolygonSplit& split = work.split;
  const auto count = static_cast<std::uint32_t>(corners.size());
  if (count == 4 && work.split_quad(corners)) return split;
  if (count == 3 || work.flat.empty()) {
    for (std::uint32_t i = 1; i + 1 < count; ++i) split.triangles.push_back({0, i, i + 1});
    return split;
  }
  const double steps = sweep_steps(work.flat, work.steps_left);
  if (steps > work.steps_left) {
    split.outcome = PolygonSplit::Outcome::too_intricate;
    return split;
  }
  work.steps_left -= steps * work.tessellate_soundly();
  if (work.failed) split.outcome = PolygonSplit::Outcome::too_intricate;
  return split;
}

}  // namespace penumbra
