// Shadow results compared with independent methods: closed forms, exact integer arithmetic, slabs
// between crossings, and distances to shapes.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <glm/common.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <numbers>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "render/shadow/casters/caster.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/kernels/twist.hpp"
#include "render/shadow/layers/layer_polygons.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct IntegerPoint {
  std::int64_t x = 0, y = 0;
};
std::int64_t twice_area(const std::array<IntegerPoint, 3>& p) {
  return (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[1].y - p[0].y) * (p[2].x - p[0].x);
}

// Computes the images of each face at 4096 factors in integer arithmetic. A face is twisted if the
// signed area of at least one image has the opposite sign.
TEST(TwistReport, MatchesExactIntegerAreas) {
  constexpr std::int64_t kSteps = 4096;           // steps per unit of the factor
  constexpr std::int64_t kMinStep = kSteps / 16;  // 0.0625
  constexpr std::int64_t kMaxStep = kSteps * 27 / 16;
  std::mt19937 random(3);
  std::uniform_int_distribution<std::int64_t> coordinate(-200, 200);
  std::uniform_int_distribution<std::int64_t> offset(-60, 60);
  std::size_t all_twisted = 0;
  std::size_t all_ambiguous = 0;
  std::size_t only_between = 0;  // twisted, but at neither end of the range of factors
  for (int set = 0; set < 10; ++set) {
    std::vector<IntegerPoint> x(40);
    std::vector<IntegerPoint> k(40);
    std::vector<CasterVertex> vertices;
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = {coordinate(random), coordinate(random)};
      // Kernels: a quarter at random positions, a quarter shared with the previous vertex, half
      // near the vertex.
      k[i] = i % 4 == 0   ? IntegerPoint{coordinate(random) / 4, coordinate(random) / 4}
             : i % 4 == 1 ? k[i - 1]
                          : IntegerPoint{x[i].x + offset(random), x[i].y + offset(random)};
      constexpr float kUnit = 1.0F / 1024.0F;  // multiples of it are exact in float
      vertices.push_back({static_cast<float>(x[i].x) * kUnit, static_cast<float>(x[i].y) * kUnit,
                          0.1F, static_cast<float>(k[i].x) * kUnit,
                          static_cast<float>(k[i].y) * kUnit});
    }
    std::vector<std::uint32_t> indices;
    std::uniform_int_distribution<std::uint32_t> any_vertex(0, 39);
    for (int i = 0; i < 3 * 60; ++i) indices.push_back(any_vertex(random));
    std::size_t tested = 0;
    std::size_t twisted = 0;
    std::size_t ambiguous = 0;
    double twisted_area = 0.0;
    double tested_area = 0.0;
    for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
      const auto image = [&](std::int64_t step) {
        std::array<IntegerPoint, 3> p;
        for (std::size_t corner = 0; corner < 3; ++corner) {
          const IntegerPoint& from = k[indices[i + corner]];
          const IntegerPoint& to = x[indices[i + corner]];
          p[corner] = {kSteps * from.x + step * (to.x - from.x),
                       kSteps * from.y + step * (to.y - from.y)};
        }
        return twice_area(p);
      };
      const std::int64_t full_area = image(kSteps);
      if (full_area == 0) continue;
      ++tested;
      const auto relative_area = [&](std::int64_t step) {
        return static_cast<double>(image(step)) / static_cast<double>(full_area);
      };
      double smallest = kInfinity;
      for (std::int64_t step = kMinStep; step <= kMaxStep; ++step)
        smallest = std::min(smallest, relative_area(step));
      tested_area += static_cast<double>(std::abs(full_area));
      // A smaller area could change sign between two steps. At most three faces are that ambiguous.
      ambiguous += smallest >= 0.0 && smallest < 1e-6 ? 1U : 0U;
      if (smallest >= 0.0) continue;
      ++twisted;
      twisted_area += static_cast<double>(std::abs(full_area));
      only_between += relative_area(kMinStep) >= 0.0 && relative_area(kMaxStep) >= 0.0 ? 1U : 0U;
    }
    const TwistReport report = find_twists(vertices, indices, 1.0 / 16.0, 27.0 / 16.0);
    EXPECT_EQ(report.faces_tested, tested);
    EXPECT_LE(report.faces_twisted, twisted + ambiguous);
    EXPECT_GE(report.faces_twisted, twisted);
    if (report.faces_twisted == twisted) {
      EXPECT_NEAR(report.area_share, twisted_area / tested_area, 1e-9);
    }
    all_twisted += twisted;
    all_ambiguous += ambiguous;
  }
  EXPECT_GT(all_twisted, 100U);
  EXPECT_LT(all_twisted, 500U);
  EXPECT_GT(only_between, 0U) << "faces that fold over and back";
  EXPECT_LE(all_ambiguous, 3U);
}

// Boxes with one kernel each rise in steps of 1 cm from below the plane to above the cap. The
// shadow of a box's cross-section at each height is a rectangle about the kernel, and the largest
// rectangle contains the others.
TEST(ShadowReference, MatchesAreasOfRisingBoxes) {
  struct Light {
    double height, ratio, umbra_height;
  };
  constexpr double kThick = 0.05;
  constexpr double kWide = 0.06;
  constexpr double kDeep = 0.04;
  constexpr double kGap = 0.05;  // gap between the boxes, less than a penumbra's width
  test::ShapeBuilder shape;
  shape.box(0, 0, 0, kWide, kDeep, kThick);
  shape.box(kWide + kGap, 0, 0, 2 * kWide + kGap, kDeep, kThick);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  ASSERT_EQ(mesh.part_count, 2U);
  ShadowKernels kernels{Eigen::Vector3d::UnitZ(), {}, {}};
  constexpr double kKernelX = 0.02;  // offset from each box's corner
  constexpr double kKernelY = 0.03;
  for (const glm::vec3& p : mesh.positions) {
    const double corner = p.x > static_cast<float>(kWide) + 0.01F ? kWide + kGap : 0.0;
    kernels.kernels.emplace_back(corner + kKernelX, kKernelY, 0.0F);
  }
  for (const Light& light : {Light{0.9, 3.0, 0.0}, Light{0.5, 0.7, 0.0}, Light{0.6, 1.0, 0.0},
                             Light{kInfinity, 0.0, 0.3}}) {
    const LayeredConstants constants =
        make_layered_constants(light.height, light.ratio, light.umbra_height).value();
    const double h_u = light.umbra_height > 0.0 ? light.umbra_height : light.height / light.ratio;
    // The cap limits the magnification to 8; a light at the zenith has no cap.
    const double cap = std::isinf(light.height) ? kInfinity : light.height * (1.0 - 1.0 / 8.0);
    int shadows = 0;
    for (int step = -10; step <= 100; ++step) {
      const double low = 0.01 * step;
      const Placement placement = {{0.3, -0.2, low}, Eigen::Quaterniond::Identity(), 1.0};
      const auto vertices = place_caster(mesh, kernels, placement, PlaneFrame());
      for (const ShadowLayer layer : kShadowLayers) {
        const double lambda = lambda_of(layer);
        const auto factor = [&](double h) {
          return std::isinf(light.height)
                     ? 1.0 + lambda * h / h_u
                     : (light.height + lambda * light.ratio * h) / (light.height - h);
        };
        const bool vanishes = lambda < 0.0 && h_u < cap;
        const double from = std::max(low, 0.0);
        const double to = std::min(low + kThick, vanishes ? h_u : cap);
        double expected = 0.0;
        if (from < to - 1e-9) {
          const double s = std::max(factor(from), factor(to));
          const double two_areas = 2.0 * kWide * kDeep * s * s;
          // The two images are congruent, at a distance of kWide + kApart.
          const double overlap = std::max(0.0, kWide * s - (kWide + kGap)) * kDeep * s;
          expected = two_areas - overlap;
          ++shadows;
        }
        const auto outline =
            union_of_triangles(layer_triangles(vertices, mesh.indices, constants, layer));
        ASSERT_TRUE(outline);
        // At contact and at h_u, the result depends on the rounding of a height.
        if (std::abs(low + kThick) < 1e-6 || std::abs(from - to) < 1e-6) continue;
        EXPECT_NEAR(outline->area, expected, 2e-5 * expected + 1e-12)
            << "H " << light.height << ", layer " << lambda << ", at " << low;
      }
    }
    EXPECT_GT(shadows, 100);
  }
}

// Returns the area by slabs: between neighbouring events (edges that begin, end or cross), the
// covered length of a vertical line is linear. The area is therefore the length in the middle times
// the slab's width.
double area_by_slabs(const std::vector<PlanePoint>& triangles) {
  using Number = long double;
  struct Edge {
    Number x0, y0, x1, y1;
  };
  std::vector<Edge> edges;
  std::vector<Number> stops;
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const PlanePoint& a = triangles[i + corner];
      const PlanePoint& b = triangles[i + (corner + 1) % 3];
      stops.push_back(static_cast<Number>(a.u));
      Edge edge{static_cast<Number>(a.u), static_cast<Number>(a.v), static_cast<Number>(b.u),
                static_cast<Number>(b.v)};
      if (edge.x1 < edge.x0) {
        std::swap(edge.x0, edge.x1);
        std::swap(edge.y0, edge.y1);
      }
      edges.push_back(edge);
    }
  }
  const auto slope = [](const Edge& e) { return (e.y1 - e.y0) / (e.x1 - e.x0); };
  for (std::size_t i = 0; i < edges.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      const Edge& a = edges[i];
      const Edge& b = edges[j];
      if (a.x0 == a.x1 || b.x0 == b.x1 || slope(a) == slope(b)) continue;
      const Number x = (b.y0 - a.y0 + slope(a) * a.x0 - slope(b) * b.x0) / (slope(a) - slope(b));
      if (x > std::max(a.x0, b.x0) && x < std::min(a.x1, b.x1)) stops.push_back(x);
    }
  }
  std::sort(stops.begin(), stops.end());
  Number area = 0;
  std::vector<std::pair<Number, Number>> spans;
  for (std::size_t i = 0; i + 1 < stops.size(); ++i) {
    if (stops[i] == stops[i + 1]) continue;
    const Number x = (stops[i] + stops[i + 1]) / 2;
    spans.clear();
    for (std::size_t t = 0; t + 2 < edges.size(); t += 3) {
      Number low = std::numeric_limits<Number>::infinity();
      Number high = -low;
      for (std::size_t corner = 0; corner < 3; ++corner) {
        const Edge& e = edges[t + corner];
        if (!(e.x0 < x && x < e.x1)) continue;
        const Number y = e.y0 + slope(e) * (x - e.x0);
        low = std::min(low, y);
        high = std::max(high, y);
      }
      if (low < high) spans.emplace_back(low, high);
    }
    std::sort(spans.begin(), spans.end());
    Number top = -std::numeric_limits<Number>::infinity();
    for (const auto& [low, high] : spans) {
      if (high <= top) continue;
      area += (stops[i + 1] - stops[i]) * (high - std::max(low, top));
      top = high;
    }
  }
  return static_cast<double>(area);
}

TEST(TriangleUnion, MatchesAreaBySlabs) {
  EXPECT_NEAR(area_by_slabs({{0, 0}, {2, 0}, {0, 2}, {1, 0}, {3, 0}, {1, 2}}), 3.5, 1e-12);
  std::mt19937 random(17);
  std::uniform_real_distribution<float> anywhere(-1.0F, 1.0F);
  std::uniform_int_distribution<int> grid_step(-4, 4);
  for (int set = 0; set < 60; ++set) {
    // Every second set lies on a grid, where edges and corners coincide.
    const bool grid = set % 2 == 1;
    const auto coordinate = [&] {
      return grid ? static_cast<float>(grid_step(random)) / 16.0F : anywhere(random);
    };
    std::vector<PlanePoint> triangles;
    for (int i = 0; i < 3 * (1 + set % 25); ++i) triangles.push_back({coordinate(), coordinate()});
    const double expected = area_by_slabs(triangles);
    for (const std::size_t max_edges : {std::size_t{0}, std::size_t{6000}}) {
      const auto outline = union_of_triangles(triangles, max_edges);
      ASSERT_TRUE(outline);
      EXPECT_NEAR(outline->area, expected, 1e-6 * expected + 1e-12) << "set " << set;
    }
  }
}

// Level, flat bodies of uniform thickness under a disc light at the zenith. The umbra is the body's
// shape, eroded by the body's radius times h / h_u. The penumbra is the shape dilated by the same
// distance.
TEST(ShadowReference, MatchesErodedAndDilatedFlatBodies) {
  static constexpr double kRadius = 0.015;  // half the thickness
  struct Body {
    const char* name;
    Model model;
    // Distance to the outline [m]; negative outside.
    std::function<double(const Eigen::Vector2d&)> depth;
  };
  constexpr int kSides = 128;
  const auto disc = [] {
    test::ShapeBuilder shape;
    const auto middle = shape.vertex(0, 0, 0);
    std::vector<std::uint32_t> rim;
    for (int i = 0; i < kSides; ++i) {
      const double t = 2.0 * std::numbers::pi * i / kSides;
      rim.push_back(shape.vertex(kRadius * std::cos(t), kRadius * std::sin(t), 0));
    }
    for (std::size_t i = 0; i < rim.size(); ++i)
      shape.triangle(middle, rim[i], rim[(i + 1) % rim.size()]);
    return shape.build();
  };
  static constexpr double kHalf = 0.05;  // half length of a capsule's centre line
  const auto capsule = [] {
    test::ShapeBuilder shape;
    std::vector<std::array<std::uint32_t, 2>> pairs;  // across the centre line
    constexpr int kEnd = kSides / 4;
    for (int i = 1; i <= kEnd; ++i) {
      const double t = 0.5 * std::numbers::pi * i / kEnd;
      const double x = -kHalf - kRadius * std::cos(t);
      const double y = kRadius * std::sin(t);
      pairs.push_back({shape.vertex(x, -y, 0), shape.vertex(x, y, 0)});
    }
    for (int i = 1; i < 20; ++i) {
      const double x = -kHalf + 2.0 * kHalf * i / 20;
      pairs.push_back({shape.vertex(x, -kRadius, 0), shape.vertex(x, kRadius, 0)});
    }
    for (int i = kEnd; i >= 1; --i) {
      const double t = 0.5 * std::numbers::pi * i / kEnd;
      const double x = kHalf + kRadius * std::cos(t);
      const double y = kRadius * std::sin(t);
      pairs.push_back({shape.vertex(x, -y, 0), shape.vertex(x, y, 0)});
    }
    for (std::size_t i = 0; i + 1 < pairs.size(); ++i)
      shape.quad(pairs[i][0], pairs[i + 1][0], pairs[i + 1][1], pairs[i][1]);
    return shape.build();
  };
  static constexpr double kRingRadius = 0.045;  // radius of a ring's centre line
  const auto ring = [] {
    test::ShapeBuilder shape;
    std::vector<std::array<std::uint32_t, 2>> pairs;
    for (int i = 0; i < kSides; ++i) {
      const double t = 2.0 * std::numbers::pi * i / kSides;
      const auto at = [&](double r) { return shape.vertex(r * std::cos(t), r * std::sin(t), 0); };
      pairs.push_back({at(kRingRadius - kRadius), at(kRingRadius + kRadius)});
    }
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      const auto& next = pairs[(i + 1) % pairs.size()];
      shape.quad(pairs[i][0], pairs[i][1], next[1], next[0]);
    }
    return shape.build();
  };
  const std::vector<Body> bodies = {
      {"disc", disc(), [](const Eigen::Vector2d& p) { return kRadius - p.norm(); }},
      {"capsule", capsule(),
       [](const Eigen::Vector2d& p) {
         return kRadius - (p - Eigen::Vector2d(std::clamp(p.x(), -kHalf, kHalf), 0.0)).norm();
       }},
      {"ring", ring(),
       [](const Eigen::Vector2d& p) { return kRadius - std::abs(p.norm() - kRingRadius); }}};
  constexpr double kUmbraHeight = 0.3;
  const LayeredConstants constants = make_layered_constants(kInfinity, 0.0, kUmbraHeight).value();
  const KernelTuning tuning;
  for (const Body& body : bodies) {
    const ShadowMesh mesh = make_shadow_mesh(body.model);
    glm::vec3 low = mesh.positions[0];
    glm::vec3 high = low;
    for (const glm::vec3& p : mesh.positions) {
      low = glm::min(low, p);
      high = glm::max(high, p);
    }
    const auto long_side = static_cast<double>(std::max(high.x - low.x, high.y - low.y));
    const ShadowKernels kernels =
        generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
    for (const double height_fraction : {0.3, 0.6}) {
      const auto vertices = place_caster(mesh, kernels,
                                         {Eigen::Vector3d(0, 0, height_fraction * kUmbraHeight),
                                          Eigen::Quaterniond::Identity(), 1.0},
                                         PlaneFrame());
      // Tolerance of the outline: a kernel may be off by a cell's diagonal, plus the difference
      // between discs that count as equal. The layer moves by `height_fraction` of this sum. A
      // polygon approximates the outline.
      const double cells = std::clamp(
          tuning.cells_per_root * std::sqrt(static_cast<double>(mesh.positions.size())),
          static_cast<double>(tuning.min_side_cells), static_cast<double>(tuning.max_side_cells));
      const double cell = long_side / cells;
      const double tolerance =
          height_fraction * (std::numbers::sqrt2 * cell +
                             (1.0 - static_cast<double>(tuning.equal_radius)) * kRadius) +
          2e-5;
      for (const ShadowLayer layer : {ShadowLayer::umbra, ShadowLayer::penumbra}) {
        const auto outline =
            union_of_triangles(layer_triangles(vertices, mesh.indices, constants, layer));
        ASSERT_TRUE(outline);
        const double distance = lambda_of(layer) * height_fraction * kRadius;
        double length = 0.0;
        double worst = 0.0;
        const auto measure = [&](const std::vector<Eigen::Vector2d>& polygon) {
          for (std::size_t i = 0; i < polygon.size(); ++i) {
            const Eigen::Vector2d& a = polygon[i];
            const Eigen::Vector2d& b = polygon[(i + 1) % polygon.size()];
            length += (b - a).norm();
            for (int part = 0; part < 8; ++part)
              worst = std::max(worst, std::abs(body.depth(a + (b - a) * (part / 8.0)) + distance));
          }
        };
        for (const LayerPolygon& polygon : outline->polygons) {
          measure(polygon.outer);
          for (const auto& hole : polygon.holes) measure(hole);
        }
        EXPECT_LE(worst, tolerance)
            << body.name << " " << lambda_of(layer) << " at " << height_fraction;
        RecordProperty(std::string(body.name) + (lambda_of(layer) < 0 ? "_umbra" : "_penumbra") +
                           (height_fraction < 0.5 ? "_low" : "_high"),
                       std::to_string(worst / tolerance));
        // The outline is close to the exact outline. An equal area shows that it has no gap.
        const double half = kRadius + distance;
        const double exact_area = body.name[0] == 'd' ? std::numbers::pi * half * half
                                  : body.name[0] == 'c'
                                      ? std::numbers::pi * half * half + 4.0 * kHalf * half
                                      : 4.0 * std::numbers::pi * kRingRadius * half;
        EXPECT_GT(length, 0.0);
        EXPECT_NEAR(outline->area, exact_area, tolerance * length + 2e-3 * exact_area) << body.name;
      }
    }
  }
}

}  // namespace
}  // namespace penumbra
