// Splitting polygons into triangles of the same total area.
#include "render/model/polygon_splitter.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <functional>
#include <numbers>
#include <vector>

#include "core/random.hpp"

namespace penumbra {
namespace {

using Outline = std::vector<Eigen::Vector2d>;
using Polygon = std::vector<Eigen::Vector3d>;

double shoelace(const Outline& outline) {
  double doubled = 0.0;
  for (std::size_t i = 0; i < outline.size(); ++i) {
    const Eigen::Vector2d& a = outline[i];
    const Eigen::Vector2d& b = outline[(i + 1) % outline.size()];
    doubled += a.x() * b.y() - a.y() * b.x();
  }
  return 0.5 * doubled;
}

struct Areas {
  Eigen::Vector3d vector = Eigen::Vector3d::Zero();
  double sum = 0.0;  // sum of the triangles' absolute areas
};

Areas areas_of(const Polygon& corners, const PolygonSplit& split) {
  const auto position_of = [&](std::uint32_t i) {
    return i < corners.size() ? corners[i] : split.added.at(i - corners.size()).position;
  };
  Areas areas;
  for (const auto& t : split.triangles) {
    const Eigen::Vector3d area =
        0.5 * (position_of(t[1]) - position_of(t[0])).cross(position_of(t[2]) - position_of(t[0]));
    areas.vector += area;
    areas.sum += area.norm();
  }
  return areas;
}

Polygon in_space(const Outline& outline, double size = 1.0,
                 const Eigen::Quaterniond& rotation = Eigen::Quaterniond::Identity(),
                 const Eigen::Vector3d& offset = Eigen::Vector3d::Zero()) {
  Polygon corners;
  for (const Eigen::Vector2d& p : outline) {
    corners.emplace_back(rotation * Eigen::Vector3d(size * p.x(), size * p.y(), 0.0) + offset);
  }
  return corners;
}

// Checks the triangles of an outline that does not cross itself.
void expect_whole(const Outline& outline, const Polygon& corners, double size,
                  const Eigen::Vector3d& up, const std::string& name) {
  PolygonSplitter splitter;
  const PolygonSplit& split = splitter.split(corners);
  const double area = shoelace(outline) * size * size;
  const Areas areas = areas_of(corners, split);
  EXPECT_EQ(split.outcome, PolygonSplit::Outcome::split) << name;
  EXPECT_FALSE(split.crosses_itself) << name;
  EXPECT_TRUE(split.is_flat) << name;
  EXPECT_NEAR(areas.sum, std::abs(area), 1e-6 * std::abs(area)) << name;
  EXPECT_NEAR(areas.vector.dot(up), area, 1e-6 * std::abs(area)) << name;
}

using Random = SplitMix64;
double between(Random& random, double low, double high) {
  return low + (high - low) * static_cast<double>(random.below(1'000'001)) / 1e6;
}

Outline star(std::size_t corners, Random& random) {
  Outline outline;
  for (std::size_t i = 0; i < corners; ++i) {
    const double angle = 2.0 * std::numbers::pi *
                         (static_cast<double>(i) + between(random, 0, 0.8)) /
                         static_cast<double>(corners);
    outline.push_back(between(random, 0.2, 1.0) *
                      Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  }
  return outline;
}

// A comb: a bar with teeth of different heights.
Outline comb(std::size_t corners, Random& random) {
  Outline outline = {{0.0, 0.0}};
  const std::size_t teeth = std::max<std::size_t>(1, (corners - 3) / 4);
  const double width = 2.0 * static_cast<double>(teeth);
  outline.emplace_back(width, 0.0);
  outline.emplace_back(width, 0.2);
  for (std::size_t i = teeth; i-- > 0;) {
    const double x = 2.0 * static_cast<double>(i);
    const double top = between(random, 0.5, 3.0);
    outline.insert(outline.end(), {{x + 1.0, 0.2}, {x + 1.0, top}, {x, top}, {x, 0.2}});
  }
  return outline;
}

Outline spiral(std::size_t corners, Random& random) {
  Outline inner, outer;
  const double step = between(random, 0.1, 0.2);
  for (std::size_t i = 0; i < corners / 2; ++i) {
    const double angle = step * static_cast<double>(i);
    const Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
    inner.emplace_back((1.0 + 0.1 * angle) * direction);
    outer.emplace_back((1.3 + 0.1 * angle) * direction);
  }
  outer.insert(outer.end(), inner.rbegin(), inner.rend());
  return outer;
}

// A skyline with right angles. Neighbours of equal height give collinear corners.
Outline skyline(std::size_t corners, Random& random) {
  Outline outline = {{0.0, 0.0}};
  double x = 0.0;
  Outline top;
  for (std::size_t i = 0; i + 1 < corners / 2; ++i) {
    const double height = 1.0 + static_cast<double>(random.below(5));
    top.emplace_back(x, height);
    x += 1.0 + static_cast<double>(random.below(3));
    top.emplace_back(x, height);
  }
  outline.emplace_back(x, 0.0);
  outline.insert(outline.end(), top.rbegin(), top.rend());
  return outline;
}

// A star with a star-shaped hole, which a bridge joins to the outline.
Outline keyhole(std::size_t corners, Random& random) {
  const std::size_t corners_per_star = std::max<std::size_t>(8, corners / 2);
  Outline outline = star(corners_per_star, random);
  for (Eigen::Vector2d& p : outline) p *= 12.0;
  outline.push_back(outline.front());
  Outline hole = star(corners_per_star, random);
  outline.push_back(hole.front());
  outline.insert(outline.end(), hole.rbegin(), hole.rend());
  return outline;
}

// Adds repeated corners, corners on edges, and spikes that go out and back along one line.
Outline with_degenerate_corners(const Outline& outline, Random& random) {
  Outline result;
  for (std::size_t i = 0; i < outline.size(); ++i) {
    const Eigen::Vector2d edge = outline[(i + 1) % outline.size()] - outline[i];
    const Eigen::Vector2d on_edge = outline[i] + between(random, 0.4, 0.6) * edge;
    const std::uint64_t kind = random.below(8);
    result.push_back(outline[i]);
    if (kind == 0) result.push_back(outline[i]);
    if (kind == 1 || kind == 2) result.push_back(on_edge);
    if (kind == 2) {
      result.emplace_back(on_edge + 0.002 * Eigen::Vector2d(-edge.y(), edge.x()));
      result.push_back(on_edge);
    }
  }
  return result;
}

TEST(PolygonSplitter, KeepsAreaOfRandomSimplePolygons) {
  const std::vector<std::pair<std::string, std::function<Outline(std::size_t, Random&)>>> kinds = {
      {"star", star},
      {"comb", comb},
      {"spiral", spiral},
      {"skyline", skyline},
      {"keyhole", keyhole}};
  Random random(1);
  for (int i = 0; i < 3000; ++i) {
    const auto& [kind, make] = kinds[static_cast<std::size_t>(i) % kinds.size()];
    const std::size_t corners = 4 + random.below(497);
    Outline outline = make(corners, random);
    if (random.below(2) == 0) outline = with_degenerate_corners(outline, random);
    if (random.below(2) == 0) outline = Outline(outline.rbegin(), outline.rend());
    const double size = std::pow(10.0, between(random, -4.0, 4.0));
    Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
    if (random.below(4) != 0) {
      rotation = Eigen::Quaterniond(between(random, -1, 1), between(random, -1, 1),
                                    between(random, -1, 1), between(random, -1, 1) + 1e-3)
                     .normalized();
    }
    const Eigen::Vector3d offset =
        size * std::pow(10.0, between(random, -3.0, 4.0)) *
        Eigen::Vector3d(between(random, -1, 1), between(random, -1, 1), between(random, -1, 1));
    expect_whole(outline, in_space(outline, size, rotation, offset), size,
                 rotation * Eigen::Vector3d::UnitZ(), fmt::format("{} {}", kind, i));
  }
}

TEST(PolygonSplitter, KeepsEveryCornerOfSimplePolygon) {
  Random random(2);
  for (const auto& make : {star, comb, spiral}) {
    const Polygon corners = in_space(make(40, random));
    PolygonSplitter splitter;
    const PolygonSplit& split = splitter.split(corners);
    EXPECT_EQ(split.triangles.size(), corners.size() - 2);
    EXPECT_TRUE(split.added.empty());
    std::vector<bool> used(corners.size(), false);
    for (const auto& t : split.triangles) {
      for (const std::uint32_t corner : t) used.at(corner) = true;
    }
    EXPECT_EQ(std::count(used.begin(), used.end(), true), std::ptrdiff_t(corners.size()));
  }
}

TEST(PolygonSplitter, SplitsConcaveQuadAlongInnerDiagonal) {
  const Outline arrow = {{0, 0}, {2, 1}, {0, 2}, {0.7, 1}};
  for (std::size_t first = 0; first < 4; ++first) {
    Outline outline = arrow;
    std::rotate(outline.begin(), outline.begin() + std::ptrdiff_t(first), outline.end());
    expect_whole(outline, in_space(outline), 1.0, Eigen::Vector3d::UnitZ(), "arrow");
    std::reverse(outline.begin(), outline.end());
    expect_whole(outline, in_space(outline), 1.0, Eigen::Vector3d::UnitZ(), "arrow, clockwise");
  }
}

TEST(PolygonSplitter, FillsCrossingOutlineByNonZeroWinding) {
  const auto split_area = [](const Outline& outline, bool crosses) {
    PolygonSplitter splitter;
    const Polygon corners = in_space(outline);
    const PolygonSplit& split = splitter.split(corners);
    EXPECT_EQ(split.crosses_itself, crosses);
    return areas_of(corners, split).sum;
  };
  EXPECT_NEAR(split_area({{0, 0}, {1, 1}, {1, 0}, {0, 1}}, true), 0.5, 1e-9) << "bow tie";
  Outline pentagram;
  for (int i = 0; i < 5; ++i) {
    const double angle = 4.0 * std::numbers::pi * i / 5.0;
    pentagram.emplace_back(std::cos(angle), std::sin(angle));
  }
  // The outer triangles plus the pentagon, which has winding number 2.
  EXPECT_NEAR(split_area(pentagram, true), 1.12256994, 1e-7);
  const Outline twice = {{0, 0}, {1, 0}, {1, 1}, {0, 1}, {0, 0}, {1, 0}, {1, 1}, {0, 1}};
  EXPECT_NEAR(split_area(twice, true), 1.0, 1e-9);
  const Outline there_and_back = {{0, 0}, {1, 0}, {1, 1}, {2, 2}, {1, 1}, {1, 0}};
  EXPECT_EQ(split_area(there_and_back, false), 0.0);
}

TEST(PolygonSplitter, InterpolatesCrossingFromCorners) {
  const Polygon corners = in_space({{0, 0}, {4, 4}, {4, 0}, {0, 4}});
  PolygonSplitter splitter;
  const PolygonSplit& split = splitter.split(corners);
  ASSERT_EQ(split.added.size(), 1U);
  const AddedCorner& added = split.added.front();
  EXPECT_LT((added.position - Eigen::Vector3d(2, 2, 0)).norm(), 1e-9);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < 4; ++i) {
    mean += static_cast<double>(added.weights[i]) * corners.at(added.of_corners[i]);
  }
  EXPECT_LT((mean - added.position).norm(), 1e-6);
}

TEST(PolygonSplitter, DetectsPolygonThatIsNotFlat) {
  Polygon corners = in_space({{0, 0}, {1, 0}, {1, 1}, {0, 1}});
  corners[2].z() = 0.004;
  PolygonSplitter splitter;
  EXPECT_TRUE(splitter.split(corners).is_flat);
  corners[2].z() = 0.5;
  const PolygonSplit& split = splitter.split(corners);
  EXPECT_FALSE(split.is_flat);
  EXPECT_FALSE(split.crosses_itself);
  // For any split, the area vectors of the triangles add up to the area vector of the outline.
  const Eigen::Vector3d outline = 0.5 * (corners[2] - corners[0]).cross(corners[3] - corners[1]);
  EXPECT_LT((areas_of(corners, split).vector - outline).norm(), 1e-9);
}

TEST(PolygonSplitter, KeepsCornersOfPolygonWithoutArea) {
  PolygonSplitter splitter;
  const Polygon point(6, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(splitter.split(point).triangles.size(), 4U);
  EXPECT_EQ(splitter.split(in_space({{0, 0}, {1, 1}, {3, 3}, {2, 2}, {5, 5}})).triangles.size(),
            3U);
}

// GLU's tessellator alone would take hours on these outlines, so the splitter limits its work.
TEST(PolygonSplitter, RejectsIntricatePolygonsInBoundedTime) {
  const auto start = std::chrono::steady_clock::now();
  Random random(3);
  Outline crossing, overlapping = {{0, 1}}, spikes, zigzag;
  for (int i = 0; i < 100'000; ++i) {
    crossing.emplace_back(between(random, -1, 1), between(random, -1, 1));
    overlapping.emplace_back(between(random, -1, 1), 0.0);
    spikes.emplace_back(crossing.back());
    spikes.emplace_back(0.0, 0.0);
    zigzag.emplace_back(i % 2 == 0 ? 0.0 : 1.0, between(random, -1, 1));
  }
  Outline gear;
  for (int i = 0; i < 100'000; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / 100'000;
    gear.emplace_back((i % 2 == 0 ? 1.0 : 0.999) *
                      Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  }
  for (const Outline& outline : {crossing, overlapping, spikes, zigzag, gear}) {
    PolygonSplitter splitter;
    EXPECT_EQ(splitter.split(in_space(outline)).outcome, PolygonSplit::Outcome::too_intricate);
  }
  // The limit covers all polygons of a splitter, so many small polygons exceed it too.
  PolygonSplitter splitter;
  crossing.resize(60);
  std::size_t rejected = 0;
  for (int i = 0; i < 20'000; ++i) {
    const PolygonSplit& split = splitter.split(in_space(crossing));
    rejected += split.outcome == PolygonSplit::Outcome::too_intricate ? 1 : 0;
  }
  EXPECT_GT(rejected, 10'000U);
  const std::chrono::duration<double> duration = std::chrono::steady_clock::now() - start;
  EXPECT_LT(duration.count(), 60.0);
}

TEST(PolygonSplitter, SplitsThousandsOfCorners) {
  Outline circle;
  constexpr int kCorners = 10'000;
  for (int i = 0; i < kCorners; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kCorners;
    const double radius = i % 2 == 0 ? 1.0 : 0.999;
    circle.emplace_back(radius * std::cos(angle), radius * std::sin(angle));
  }
  expect_whole(circle, in_space(circle), 1.0, Eigen::Vector3d::UnitZ(), "gear");
  circle.clear();
  for (int i = 0; i < 10 * kCorners; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / (10 * kCorners);
    circle.emplace_back(std::cos(angle), std::sin(angle));
  }
  expect_whole(circle, in_space(circle), 1.0, Eigen::Vector3d::UnitZ(), "circle");
}

}  // namespace
}  // namespace penumbra
