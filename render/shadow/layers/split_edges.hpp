// Triangles cut at the middles of their edges, the longest first, until no edge is too long: what
// is drawn then follows a lens that bends straight lines.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

namespace penumbra {

// Three points per triangle, here and in the result; the orientation stays. `excess(a, b)`: an
// edge's length over what is allowed, the same for (b, a); above 1 it is cut. `middle(a, b)`: the
// point to cut it at. `left_out(a, b, c)`: nobody sees this triangle. Nothing where the result
// would be of more than `max_triangles`.
template <class Point, class Excess, class Middle, class LeftOut>
[[nodiscard]] std::optional<std::vector<Point>> split_triangles(std::vector<Point> triangles,
                                                                const Excess& excess,
                                                                const Middle& middle,
                                                                const LeftOut& left_out,
                                                                std::size_t max_triangles) {
  std::vector<Point> done;
  done.reserve(triangles.size());
  const auto put = [](std::vector<Point>& to, const Point& p, const Point& q, const Point& r) {
    for (const Point& point : {p, q, r}) to.push_back(point);
  };
  while (!triangles.empty()) {
    const Point c = triangles.back();
    const Point b = triangles[triangles.size() - 2];
    const Point a = triangles[triangles.size() - 3];
    triangles.resize(triangles.size() - 3);
    if (left_out(a, b, c)) continue;
    if ((done.size() + triangles.size()) / 3 >= max_triangles) return std::nullopt;
    const auto ab = excess(a, b);
    const auto bc = excess(b, c);
    const auto ca = excess(c, a);
    const auto most = std::max({ab, bc, ca});
    if (!(most > 1)) {
      put(done, a, b, c);
    } else if (ab == most) {
      const Point m = middle(a, b);
      put(triangles, a, m, c);
      put(triangles, m, b, c);
    } else if (bc == most) {
      const Point m = middle(b, c);
      put(triangles, a, b, m);
      put(triangles, a, m, c);
    } else {
      const Point m = middle(c, a);
      put(triangles, a, b, m);
      put(triangles, m, b, c);
    }
  }
  return done;
}

// How long an edge may be by its distance: seen from within this distance [m] as the lens asks, and
// farther away this share of what it is farther: 28 px for a lens of 700 px.
inline constexpr double kSplitNear_m = 0.5;
inline constexpr double kSplitShare = 0.04;

// `split(coarser)` with edges allowed to be 1, 2, 4, ... times as long, until that is within its
// budget; what was given where nothing is.
template <class Point, class Split>
[[nodiscard]] std::vector<Point> split_within_budget(const std::vector<Point>& triangles,
                                                     const Split& split) {
  for (double coarser = 1.0; coarser < 1000.0; coarser *= 2.0) {
    if (std::optional<std::vector<Point>> made = split(coarser)) return std::move(*made);
  }
  return triangles;
}

}  // namespace penumbra
