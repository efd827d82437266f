#include "render/scene/shapes.hpp"

#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <numbers>
#include <utility>

#include "core/assert.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra {
namespace {

Model finished(std::string name, Mesh mesh) {
  Model model;
  model.name = name;
  mesh.name = std::move(name);
  for (std::uint32_t i = 0; i < mesh.positions.size(); ++i) mesh.source_vertex.push_back(i);
  model.source_vertex_count = static_cast<std::uint32_t>(mesh.positions.size());
  model.meshes.push_back(std::move(mesh));
  model.materials.emplace_back();
  const Result<void> checked = check_model(model, model.name, ModelLimits{});
  PENUMBRA_ASSERT(checked.has_value());
  return model;
}

// Returns the point on the unit circle at i / count of a turn; 0 and count give equal floats.
glm::vec2 on_circle(int i, int count) {
  const double angle = 2.0 * std::numbers::pi * (i % count) / count;
  return {static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle))};
}

struct Point {
  glm::vec3 position, normal;
};

// Adds a grid of (columns + 1) x (rows + 1) points, without triangles whose corners coincide.
void add_sheet(Mesh& mesh, int columns, int rows, const std::function<Point(int, int)>& at) {
  const auto first = static_cast<std::uint32_t>(mesh.positions.size());
  for (int row = 0; row <= rows; ++row) {
    for (int column = 0; column <= columns; ++column) {
      const Point point = at(column, row);
      mesh.positions.push_back(point.position);
      mesh.normals.push_back(point.normal);
    }
  }
  const auto add = [&mesh](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    const std::vector<glm::vec3>& p = mesh.positions;
    if (p[a] != p[b] && p[b] != p[c] && p[c] != p[a]) {
      mesh.indices.insert(mesh.indices.end(), {a, b, c});
    }
  };
  const auto width = static_cast<std::uint32_t>(columns) + 1;
  for (std::uint32_t row = 0; row < static_cast<std::uint32_t>(rows); ++row) {
    for (std::uint32_t column = 0; column + 1 < width; ++column) {
      const std::uint32_t a = first + row * width + column;
      add(a, a + 1, a + width + 1);
      add(a, a + width + 1, a + width);
    }
  }
}

}  // namespace

Model make_box(const glm::vec3& size) {
  Mesh mesh;
  const glm::vec3 half = size * 0.5F;
  for (int axis = 0; axis < 3; ++axis) {
    for (const float side : {-1.0F, 1.0F}) {
      glm::vec3 normal(0.0F);
      normal[axis] = side;
      add_sheet(mesh, 1, 1, [&](int column, int row) {
        glm::vec3 p(0.0F);
        p[axis] = side * half[axis];
        // Orders the other two axes so that the triangles face outwards.
        const int u = side > 0.0F ? (axis + 1) % 3 : (axis + 2) % 3;
        const int v = side > 0.0F ? (axis + 2) % 3 : (axis + 1) % 3;
        p[u] = column == 0 ? -half[u] : half[u];
        p[v] = row == 0 ? -half[v] : half[v];
        return Point{p, normal};
      });
    }
  }
  return finished("box", std::move(mesh));
}

Model make_sphere(float radius) {
  Mesh mesh;
  constexpr int kColumns = 48, kRows = 24;
  add_sheet(mesh, kColumns, kRows, [radius](int column, int row) {
    const glm::vec2 c = on_circle(column, kColumns);
    const double polar = std::numbers::pi * row / kRows;  // from the south pole
    const bool pole = row == 0 || row == kRows;
    const auto ring = pole ? 0.0F : static_cast<float>(std::sin(polar));
    const glm::vec3 n(ring * c.x, ring * c.y, static_cast<float>(-std::cos(polar)));
    return Point{n * radius, n};
  });
  return finished("sphere", std::move(mesh));
}

Model make_cylinder(float radius, float height) {
  Mesh mesh;
  constexpr int kColumns = 48;
  const float half = height * 0.5F;
  add_sheet(mesh, kColumns, 1, [&](int column, int row) {
    const glm::vec2 c = on_circle(column, kColumns);
    return Point{{c.x * radius, c.y * radius, row == 0 ? -half : half}, {c.x, c.y, 0.0F}};
  });
  for (const float side : {-1.0F, 1.0F}) {
    add_sheet(mesh, kColumns, 1, [&](int column, int row) {
      const glm::vec2 c = on_circle(column, kColumns);
      const float r = (row == 0) == (side < 0.0F) ? 0.0F : radius;
      return Point{{c.x * r, c.y * r, side * half}, {0.0F, 0.0F, side}};
    });
  }
  return finished("cylinder", std::move(mesh));
}

Model make_ring(float radius, float thickness) {
  Mesh mesh;
  constexpr int kColumns = 64, kRows = 16;
  const float tube = thickness * 0.5F;
  add_sheet(mesh, kColumns, kRows, [&](int column, int row) {
    const glm::vec2 c = on_circle(column, kColumns);
    const glm::vec2 t = on_circle(row, kRows);
    const float r = radius + tube * t.x;
    return Point{{c.x * r, c.y * r, tube * t.y}, {c.x * t.x, c.y * t.x, t.y}};
  });
  return finished("ring", std::move(mesh));
}

}  // namespace penumbra
