// Splits triangles at the midpoints of their edges, the longest first, until no edge is too long,
// so that they follow the lens distortion.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

namespace penumbra {

// Three points per triangle, here and in the result; keeps the orientation. excess(a, b): an edge's
// length divided by the allowed length, symmetric. middle(a, b): the point at which to split it.
// Triangles with is_invisible(a, b, c) are dropped. Returns nullopt if the result would exceed
// `max_triangles`.
template <class Point, class Excess, class Middle, class IsInvisible>
[[nodiscard]] std::optional<std::vector<Point>> split_triangles(std::vector<Point> triangles,
                                                                const Excess& excess,
                                                                const Middle& middle,
                                                                const IsInvisible& is_invisible,
                                                                std::size_t max_triangles) {
  std::vector<Point> done;
  done.reserve(triangles.size());
  const auto append = [](std::vector<Point>& to, const Point& p, const Point& q, const Point& r) {
    to.insert(to.end(), {p, q, r});
  };
  while (!triangles.empty()) {
    const Point c = triangles.back();
    const Point b = triangles[triangles.size() - 2];
    const Point a = triangles[triangles.size() - 3];
    triangles.resize(triangles.size() - 3);
    if (is_invisible(a, b, c)) continue;
    if ((done.size() + triangles.size()) / 3 >= max_triangles) return std::nullopt;
    const auto ab = excess(a, b);
    const auto bc = excess(b, c);
    const auto ca = excess(c, a);
    const auto largest = std::max({ab, bc, ca});
    if (!(largest > 1)) {
      append(done, a, b, c);
    } else if (ab == largest) {
      const Point m = middle(a, b);
      append(triangles, a, m, c);
      append(triangles, m, b, c);
    } else if (bc == largest) {
      const Point m = middle(b, c);
      append(triangles, a, b, m);
      append(triangles, a, m, c);
    } else {
      const Point m = middle(c, a);
      append(triangles, a, b, m);
      append(triangles, m, b, c);
    }
  }
  return done;
}

// Up to the distance kSplitNear_m, an edge may be as long as the lens allows. Farther away, it may
// be longer by kSplitShare of the additional distance: 28 px at a focal length of 700 px.
inline constexpr double kSplitNear_m = 0.5;
inline constexpr double kSplitShare = 0.04;

// Calls split(factor on the allowed edge length) with 1, 2, 4, ... until it returns a result.
// Returns `triangles` if no call returns a result.
template <class Point, class Split>
[[nodiscard]] std::vector<Point> split_within_budget(const std::vector<Point>& triangles,
                                                     const Split& split) {
  for (double coarser = 1.0; coarser < 1000.0; coarser *= 2.0) {
    if (std::optional<std::vector<Point>> made = split(coarser)) return std::move(*made);
  }
  return triangles;
}

}  // namespace penumbra
