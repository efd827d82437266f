// Sensitivity of the constants of automatic kernels (render/shadow/kernels/shadow_kernels.hpp).
// Each constant is varied alone, over random silhouettes that no test uses. Its default value
// should lie on a plateau.
//
//   kernel_constants_benchmark [SHAPES]      (default: 400)
//   scripts/benchmark --only kernel_constants
//
// A level, flat body under a light at the zenith has an exact shadow. The umbra is its outline
// eroded by the radius of the light's image, and the penumbra is the outline dilated by it. The
// layers of each set of kernels are compared with it at two heights.
#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <limits>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/layers/coverage.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

constexpr double kUmbraHeight = 0.3;              // [m]
constexpr std::array kHeightShares = {0.3, 0.6};  // relative to the umbra height
constexpr int kPixels = 256;

using Random = std::mt19937;
double uniform(Random& random, double from, double to) {
  return std::uniform_real_distribution<double>(from, to)(random);
}

// Adds a closed outline of radius radius(angle) about the origin, as rings of vertices from the
// centre outwards.
void add_round(test::ShapeBuilder& shape, const std::function<double(double)>& radius) {
  constexpr std::uint32_t kRings = 4;
  constexpr std::uint32_t kSegments = 72;
  const std::uint32_t middle = shape.vertex(0, 0, 0);
  std::vector<std::uint32_t> rings;
  for (std::uint32_t ring = 1; ring <= kRings; ++ring) {
    for (std::uint32_t i = 0; i < kSegments; ++i) {
      const double angle = 2.0 * std::numbers::pi * i / kSegments;
      const double r = radius(angle) * ring / kRings;
      rings.push_back(shape.vertex(r * std::cos(angle), r * std::sin(angle), 0));
    }
  }
  for (std::uint32_t i = 0; i < kSegments; ++i) {
    const std::uint32_t j = (i + 1) % kSegments;
    shape.triangle(middle, rings[i], rings[j]);
    for (std::uint32_t ring = 0; ring + 1 < kRings; ++ring) {
      shape.quad(rings[ring * kSegments + i], rings[(ring + 1) * kSegments + i],
                 rings[(ring + 1) * kSegments + j], rings[ring * kSegments + j]);
    }
  }
}

Model star(Random& random) {
  const int points = std::uniform_int_distribution(4, 9)(random);
  const double inner = uniform(random, 0.25, 0.7);
  const double start_angle = uniform(random, 0.0, 6.0);
  test::ShapeBuilder shape;
  add_round(shape, [&](double angle) {
    const double phase = std::fmod((angle + start_angle) * points / (2.0 * std::numbers::pi), 1.0);
    return 0.1 * (inner + (1.0 - inner) * std::abs(2.0 * phase - 1.0));
  });
  return shape.build();
}

Model round_body(Random& random) {
  std::array<double, 4> height{};
  std::array<double, 4> phase{};
  for (std::size_t i = 0; i < height.size(); ++i) {
    height[i] = uniform(random, 0.0, 0.3) / static_cast<double>(i + 1);
    phase[i] = uniform(random, 0.0, 6.0);
  }
  test::ShapeBuilder shape;
  add_round(shape, [&](double angle) {
    double r = 1.0;
    for (std::size_t i = 0; i < height.size(); ++i)
      r += height[i] * std::cos(static_cast<double>(i + 2) * angle + phase[i]);
    return 0.07 * std::max(r, 0.2);
  });
  return shape.build();
}

// Adds a band of half width `half_width(t)` along `path(t)`, t from 0 to 1. It has three rows of
// vertices: left edge, centre line and right edge.
void add_band(test::ShapeBuilder& shape, const std::function<Eigen::Vector2d(double)>& path,
              const std::function<double(double)>& half_width) {
  constexpr int kSteps = 40;
  std::array<std::uint32_t, 3> before{};
  for (int i = 0; i <= kSteps; ++i) {
    const double t = static_cast<double>(i) / kSteps;
    const Eigen::Vector2d p = path(t);
    const Eigen::Vector2d along = (path(t + 1e-4) - path(t - 1e-4)).normalized();
    const Eigen::Vector2d across = half_width(t) * Eigen::Vector2d(-along.y(), along.x());
    const std::array<std::uint32_t, 3> here = {
        shape.vertex(p.x() + across.x(), p.y() + across.y(), 0), shape.vertex(p.x(), p.y(), 0),
        shape.vertex(p.x() - across.x(), p.y() - across.y(), 0)};
    if (i > 0) {
      shape.quad(before[0], before[1], here[1], here[0]);
      shape.quad(before[1], before[2], here[2], here[1]);
    }
    before = here;
  }
}

Model ribbon(Random& random) {
  const double bend = uniform(random, -4.0, 4.0);
  const double sway = uniform(random, 0.0, 0.04);
  const double width = uniform(random, 0.006, 0.025);
  const double taper = uniform(random, 0.3, 1.0);
  test::ShapeBuilder shape;
  add_band(
      shape,
      [&](double t) {
        const double angle = bend * (t - 0.5);
        return Eigen::Vector2d(
            0.1 * std::sin(angle) / (std::abs(bend) < 0.3 ? 0.3 : bend) + 0.2 * (t - 0.5),
            0.06 * std::cos(angle) + sway * std::sin(9.0 * t));
      },
      [&](double t) { return width * (1.0 - (1.0 - taper) * t); });
  return shape.build();
}

// A trunk that becomes thinner, with branches from points of its centre line.
Model limbs(Random& random) {
  test::ShapeBuilder shape;
  const double thick = uniform(random, 0.008, 0.022);
  const auto trunk = [](double t) { return Eigen::Vector2d(0.22 * (t - 0.5), 0.0); };
  add_band(shape, trunk, [&](double t) { return thick * (1.0 - 0.5 * t); });
  const int branches = std::uniform_int_distribution(1, 4)(random);
  for (int i = 0; i < branches; ++i) {
    const int joint = std::uniform_int_distribution(3, 36)(random);
    const Eigen::Vector2d from = trunk(joint / 40.0);
    const double angle = uniform(random, 0.5, 2.6) * (random() % 2 == 0 ? 1.0 : -1.0);
    const double length = uniform(random, 0.04, 0.1);
    const double width = thick * uniform(random, 0.3, 0.9);
    const Eigen::Vector2d along(length * std::cos(angle), length * std::sin(angle));
    add_band(
        shape, [&](double t) { return Eigen::Vector2d(from + t * along); },
        [&](double t) { return width * (1.0 - 0.4 * t); });
  }
  return shape.build();
}

// Squares that touch along their edges.
Model tiles(Random& random) {
  constexpr double kSide = 0.04;
  constexpr int kParts = 4;
  std::vector<std::array<int, 2>> squares = {{0, 0}};  // column, row
  const auto count = std::uniform_int_distribution<std::size_t>(2, 7)(random);
  while (squares.size() < count) {
    std::array<int, 2> square =
        squares[std::uniform_int_distribution<std::size_t>(0, squares.size() - 1)(random)];
    square[random() % 2] += random() % 2 == 0 ? 1 : -1;
    if (std::find(squares.begin(), squares.end(), square) == squares.end())
      squares.push_back(square);
  }
  test::ShapeBuilder shape;
  for (const auto& [column, row] : squares) {
    const auto at = [&](int i, int j) {
      return shape.vertex(kSide * (column + static_cast<double>(i) / kParts),
                          kSide * (row + static_cast<double>(j) / kParts), 0);
    };
    for (int i = 0; i < kParts; ++i)
      for (int j = 0; j < kParts; ++j)
        shape.quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
  }
  return shape.build();
}

constexpr std::array kKinds = {&star, &ribbon, &tiles, &round_body, &limbs};

// A silhouette with its exact umbra and penumbra at two heights.
struct Silhouette {
  struct Level {
    Placement placement;
    Coverage umbra, penumbra;
  };
  ShadowMesh mesh;
  LayeredConstants constants;
  PlaneFrame plane;
  Eigen::Vector2f low = Eigen::Vector2f::Zero();  // lowest corner of the raster [m]
  float pixel = 0.0F;                             // size of a pixel [m]
  std::vector<Level> levels;

  [[nodiscard]] Coverage empty() const { return {low, pixel, kPixels, kPixels}; }
};

Silhouette make_silhouette(Model model, Random& random) {
  // A random rotation, because rasters would otherwise be aligned with edges.
  const double angle = uniform(random, 0.0, 6.0);
  for (glm::vec3& p : model.meshes[0].positions) {
    const Eigen::Vector2d q = Eigen::Rotation2Dd(angle) *
                              Eigen::Vector2d(static_cast<double>(p.x), static_cast<double>(p.y));
    p.x = static_cast<float>(q.x());
    p.y = static_cast<float>(q.y());
  }
  Silhouette result;
  result.mesh = make_shadow_mesh(model);
  result.constants =
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, kUmbraHeight).value();
  const auto discs = part_discs(result.mesh, result.plane.n);
  Eigen::Vector2f low = Eigen::Vector2f::Constant(std::numeric_limits<float>::infinity());
  Eigen::Vector2f high = -low;
  for (const glm::vec3& p : result.mesh.positions) {
    low = low.cwiseMin(Eigen::Vector2f(p.x, p.y));
    high = high.cwiseMax(Eigen::Vector2f(p.x, p.y));
  }
  const float half = 0.5F * (high - low).maxCoeff() + discs[0].radius;
  result.low = 0.5F * (low + high) - Eigen::Vector2f::Constant(half);
  result.pixel = 2.0F * half / kPixels;
  for (const double fraction : kHeightShares) {
    Silhouette::Level level{
        {Eigen::Vector3d(0, 0, fraction * kUmbraHeight), Eigen::Quaterniond::Identity(), 1.0},
        result.empty(),
        result.empty()};
    const ShadowKernels none{result.plane.n, result.mesh.positions, {}};
    ShadowFieldOptions fine;
    fine.cells = 1024;
    const ShadowField field = power_distance_layers(
        place_caster(result.mesh, none, level.placement, result.plane), result.mesh.indices,
        result.mesh.part, part_lights(discs, level.placement, result.plane), result.constants,
        fine);
    level.umbra.cover(field_triangles(field, ShadowLayer::umbra));
    level.penumbra.cover(field_triangles(field, ShadowLayer::penumbra));
    result.levels.push_back(std::move(level));
  }
  return result;
}

struct Agreement {
  double umbra = 0.0, penumbra = 0.0, cpu_ms = 0.0;  // means over all silhouettes
};

Agreement judge(const std::vector<Silhouette>& silhouettes, const KernelTuning& tuning) {
  Agreement mean;
  const auto cpu_ms = [] {
    return 1e3 * static_cast<double>(std::clock()) / static_cast<double>(CLOCKS_PER_SEC);
  };
  for (const Silhouette& silhouette : silhouettes) {
    const double start = cpu_ms();
    const ShadowKernels kernels = generate_kernels(silhouette.mesh, silhouette.plane.n,
                                                   KernelSource::automatic, nullptr, tuning);
    mean.cpu_ms += (cpu_ms() - start) / static_cast<double>(silhouettes.size());
    for (const Silhouette::Level& level : silhouette.levels) {
      const auto vertices =
          place_caster(silhouette.mesh, kernels, level.placement, silhouette.plane);
      const double weight =
          1.0 / static_cast<double>(silhouettes.size() * silhouette.levels.size());
      const auto agreement = [&](ShadowLayer layer, const Coverage& exact) {
        Coverage covered = silhouette.empty();
        covered.cover(
            layer_triangles(vertices, silhouette.mesh.indices, silhouette.constants, layer));
        return covered.iou(exact);
      };
      mean.umbra += weight * agreement(ShadowLayer::umbra, level.umbra);
      mean.penumbra += weight * agreement(ShadowLayer::penumbra, level.penumbra);
    }
  }
  return mean;
}

void run(int count) {
  Random random(2024);
  std::vector<Silhouette> silhouettes;
  for (int i = 0; i < count; ++i) {
    silhouettes.push_back(
        make_silhouette(kKinds[static_cast<std::size_t>(i) % kKinds.size()](random), random));
  }
  fmt::print("{} silhouettes      value   IoU umbra  penumbra   CPU [ms]\n", count);
  // Sets a constant; returns true if the value is the default.
  using Set = std::function<bool(KernelTuning&, double)>;
  const auto vary = [&](const char* name, const std::vector<double>& values, const Set& set) {
    for (const double value : values) {
      KernelTuning tuning;
      const bool is_default = set(tuning, value);
      const Agreement mean = judge(silhouettes, tuning);
      fmt::print("{:<18} {:>7g}{}   {:>9.4f} {:>9.4f} {:>10.4f}\n", name, value,
                 is_default ? "*" : " ", mean.umbra, mean.penumbra, mean.cpu_ms);
    }
  };
  const auto member = [](auto KernelTuning::*field) {
    return [field](KernelTuning& tuning, double value) {
      const auto before = tuning.*field;
      tuning.*field = static_cast<std::remove_cvref_t<decltype(before)>>(value);
      return tuning.*field == before;
    };
  };
  vary("reach", {1.42, 1.5, 1.6, 1.75, 2.0}, member(&KernelTuning::reach));
  vary("equal_radius", {0.9, 0.92, 0.93, 0.94, 0.95, 0.96, 0.97, 0.98, 1.0},
       member(&KernelTuning::equal_radius));
  vary("ridge_slope", {0.4, 0.5, 0.6, 0.7, 0.8, 0.9}, member(&KernelTuning::ridge_slope));
  vary("shared_cells", {0, 4096, 16384, 131072}, member(&KernelTuning::shared_cells));
  vary("max_side_cells", {64, 96, 128, 192, 256}, member(&KernelTuning::max_side_cells));
  // The mesh is treated as one of thousands of parts, for which the minimum over all parts does not
  // apply.
  const auto of_many = [&](auto KernelTuning::*field) {
    return [set = member(field)](KernelTuning& tuning, double value) {
      tuning.shared_cells = 0;
      return set(tuning, value);
    };
  };
  vary("cells_per_root", {4, 6, 8, 10, 12, 16}, of_many(&KernelTuning::cells_per_root));
  vary("min_side_cells", {16, 24, 32, 48}, of_many(&KernelTuning::min_side_cells));
  fmt::print("* the value in use (the last two constants: for a body of thousands of parts)\n");
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  const int count = argc > 1 ? std::atoi(argv[1]) : 400;
  if (count < 1) {
    fmt::print(stderr, "usage: kernel_constants_benchmark [SHAPES]\n");
    return 2;
  }
  penumbra::run(count);
}
