// Small meshes made by code, for tests and benchmarks.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>
#include <vector>

#include "render/model/model.hpp"

namespace penumbra::test {

class ShapeBuilder {
 public:
  std::uint32_t vertex(double x, double y, double z) {
    mesh_.positions.emplace_back(static_cast<float>(x), static_cast<float>(y),
                                 static_cast<float>(z));
    return static_cast<std::uint32_t>(mesh_.positions.size() - 1);
  }
  void triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    mesh_.indices.insert(mesh_.indices.end(), {a, b, c});
  }
  void quad(std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
    triangle(a, b, c);
    triangle(a, c, d);
  }
  [[nodiscard]] Model build() {
    Model model;
    for (std::uint32_t i = 0; i < mesh_.positions.size(); ++i) mesh_.source_vertex.push_back(i);
    model.source_vertex_count = static_cast<std::uint32_t>(mesh_.positions.size());
    model.meshes.push_back(std::move(mesh_));
    mesh_ = {};
    return model;
  }

  void box(double x0, double y0, double z0, double x1, double y1, double z1) {
    std::uint32_t v[8];
    for (unsigned i = 0; i < 8; ++i)
      v[i] = vertex((i & 1U) != 0 ? x1 : x0, (i & 2U) != 0 ? y1 : y0, (i & 4U) != 0 ? z1 : z0);
    quad(v[0], v[2], v[3], v[1]);
    quad(v[4], v[5], v[7], v[6]);
    quad(v[0], v[1], v[5], v[4]);
    quad(v[2], v[6], v[7], v[3]);
    quad(v[0], v[4], v[6], v[2]);
    quad(v[1], v[3], v[7], v[5]);
  }

  // A prism over a polygon in x, y. Both ends are triangle fans around the first corner.
  void prism(const std::vector<std::array<double, 2>>& outline, double z0, double z1) {
    std::vector<std::uint32_t> low;
    std::vector<std::uint32_t> high;
    for (const auto& [x, y] : outline) {
      low.push_back(vertex(x, y, z0));
      high.push_back(vertex(x, y, z1));
    }
    const std::size_t n = outline.size();
    for (std::size_t i = 0; i < n; ++i) quad(low[i], low[(i + 1) % n], high[(i + 1) % n], high[i]);
    for (std::size_t i = 1; i + 1 < n; ++i) {
      triangle(low[0], low[i + 1], low[i]);
      triangle(high[0], high[i], high[i + 1]);
    }
  }

  void sphere(double radius, int rings, int segments, double x = 0, double y = 0, double z = 0) {
    surface(rings, segments, false, [&](double s, double t) {
      const double polar = std::numbers::pi * s;
      const double turn = 2.0 * std::numbers::pi * t;
      return std::array{x + radius * std::sin(polar) * std::cos(turn),
                        y + radius * std::sin(polar) * std::sin(turn),
                        z + radius * std::cos(polar)};
    });
  }
  void torus(double ring_radius, double tube_radius, int rings, int segments) {
    surface(rings, segments, true, [&](double s, double t) {
      const double tube = 2.0 * std::numbers::pi * s;
      const double turn = 2.0 * std::numbers::pi * t;
      const double r = ring_radius + tube_radius * std::cos(tube);
      return std::array{r * std::cos(turn), r * std::sin(turn), tube_radius * std::sin(tube)};
    });
  }
  // A cone frustum from p to q, open at its ends.
  void limb(const std::array<double, 3>& p, const std::array<double, 3>& q, double radius_p,
            double radius_q, int segments) {
    std::array<double, 3> d = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
    const double length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (double& component : d) component /= length;
    const std::array<double, 3> helper =
        std::abs(d[2]) < 0.9 ? std::array{0.0, 0.0, 1.0} : std::array{1.0, 0.0, 0.0};
    std::array<double, 3> e = cross(d, helper);
    const double e_length = std::sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
    for (double& component : e) component /= e_length;
    const std::array<double, 3> f = cross(d, e);
    std::vector<std::uint32_t> low;
    std::vector<std::uint32_t> high;
    for (int i = 0; i < segments; ++i) {
      const double turn = 2.0 * std::numbers::pi * i / segments;
      const double c = std::cos(turn);
      const double s = std::sin(turn);
      const auto at = [&](const std::array<double, 3>& o, double r) {
        return vertex(o[0] + r * (c * e[0] + s * f[0]), o[1] + r * (c * e[1] + s * f[1]),
                      o[2] + r * (c * e[2] + s * f[2]));
      };
      low.push_back(at(p, radius_p));
      high.push_back(at(q, radius_q));
    }
    for (std::size_t i = 0; i < low.size(); ++i)
      quad(low[i], low[(i + 1) % low.size()], high[(i + 1) % low.size()], high[i]);
  }

 private:
  static std::array<double, 3> cross(const std::array<double, 3>& a,
                                     const std::array<double, 3>& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  }
  template <class Point>
  void surface(int rings, int segments, bool closed, Point point) {
    std::vector<std::uint32_t> grid;
    const int rows = closed ? rings : rings + 1;
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j < segments; ++j) {
        const auto p = point(static_cast<double>(i) / rings, static_cast<double>(j) / segments);
        grid.push_back(vertex(p[0], p[1], p[2]));
      }
    }
    const auto at = [&](int i, int j) {
      return grid[static_cast<std::size_t>((i % rows) * segments + j % segments)];
    };
    for (int i = 0; i < rings; ++i)
      for (int j = 0; j < segments; ++j)
        quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
  }

  Mesh mesh_;
};

// Moves every vertex p to A p + t, computed in double.
inline void transform(Model& model, const Eigen::Matrix3d& A, const Eigen::Vector3d& t) {
  for (Mesh& mesh : model.meshes) {
    for (glm::vec3& p : mesh.positions) {
      const Eigen::Vector3d q =
          A * Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                              static_cast<double>(p.z)) +
          t;
      p = {static_cast<float>(q.x()), static_cast<float>(q.y()), static_cast<float>(q.z())};
    }
  }
}

inline Model box_model(double side) {
  ShapeBuilder shape;
  shape.box(-side / 2, -side / 2, -side / 2, side / 2, side / 2, side / 2);
  return shape.build();
}

inline Model torus_model(int rings, int segments) {
  ShapeBuilder shape;
  shape.torus(0.05, 0.012, rings, segments);
  return shape.build();
}

// Many unconnected limbs: a trunk and `twigs` twigs, each a separate part.
inline Model bush_model(int twigs, int segments = 8) {
  ShapeBuilder shape;
  std::mt19937 random(11);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  shape.limb({0, 0, 0}, {0, 0, 0.2}, 0.012, 0.006, 16);
  for (int i = 0; i < twigs; ++i) {
    const double turn = 2.0 * std::numbers::pi * unit(random);
    const double radius = 0.1 * std::sqrt(unit(random));
    const double z = 0.06 + 0.16 * unit(random);
    const std::array<double, 3> p = {radius * std::cos(turn), radius * std::sin(turn), z};
    const std::array<double, 3> q = {p[0] + 0.02 * (unit(random) - 0.5),
                                     p[1] + 0.02 * (unit(random) - 0.5),
                                     p[2] + 0.005 + 0.01 * unit(random)};
    shape.limb(p, q, 0.0012, 0.0004, segments);
  }
  return shape.build();
}

}  // namespace penumbra::test
