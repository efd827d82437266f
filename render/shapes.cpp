#include "render/shapes.hpp"

#include <cmath>
#include <numbers>

#include "core/assert.hpp"

namespace penumbra {
namespace {

std::uint32_t add_vertex(Mesh& mesh, const glm::vec3& position, const glm::vec3& normal) {
  mesh.positions.push_back(position);
  mesh.normals.push_back(normal);
  mesh.source_vertex.push_back(static_cast<std::uint32_t>(mesh.source_vertex.size()));
  return static_cast<std::uint32_t>(mesh.positions.size() - 1);
}

void add_triangle(Mesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  mesh.indices.insert(mesh.indices.end(), {a, b, c});
}

Model as_model(Mesh mesh, const char* name, const glm::vec3& low, const glm::vec3& high) {
  Model model;
  model.name = name;
  mesh.name = name;
  model.source_vertex_count = static_cast<std::uint32_t>(mesh.positions.size());
  model.meshes.push_back(std::move(mesh));
  model.materials.emplace_back();
  model.min_corner = low;
  model.max_corner = high;
  return model;
}

glm::vec3 around(float angle, float radius, float z) {
  return {radius * std::cos(angle), radius * std::sin(angle), z};
}

}  // namespace

Model make_box(const glm::vec3& size) {
  PENUMBRA_ASSERT(size.x > 0.0F && size.y > 0.0F && size.z > 0.0F);
  Mesh mesh;
  const glm::vec3 half(0.5F * size.x, 0.5F * size.y, 0.5F * size.z);
  const glm::vec3 centre(0.0F, 0.0F, half.z);
  for (int axis = 0; axis < 3; ++axis) {
    for (const float side : {-1.0F, 1.0F}) {
      glm::vec3 normal(0.0F);
      normal[axis] = side;
      // b x c = the outward normal, whichever the axis and side.
      glm::vec3 b(0.0F);
      glm::vec3 c(0.0F);
      b[(axis + 1) % 3] = half[(axis + 1) % 3];
      c[(axis + 2) % 3] = side * half[(axis + 2) % 3];
      const glm::vec3 face = centre + normal * half[axis];
      const std::uint32_t first = add_vertex(mesh, face - b - c, normal);
      add_vertex(mesh, face + b - c, normal);
      add_vertex(mesh, face + b + c, normal);
      add_vertex(mesh, face - b + c, normal);
      add_triangle(mesh, first, first + 1, first + 2);
      add_triangle(mesh, first, first + 2, first + 3);
    }
  }
  return as_model(std::move(mesh), "box", centre - half, centre + half);
}

Model make_sphere(float radius, int segments) {
  PENUMBRA_ASSERT(radius > 0.0F && segments >= 3);
  Mesh mesh;
  const int rings = std::max(2, segments / 2);
  const float pi = std::numbers::pi_v<float>;
  const std::uint32_t south = add_vertex(mesh, {0.0F, 0.0F, -radius}, {0.0F, 0.0F, -1.0F});
  for (int ring = 1; ring < rings; ++ring) {
    const float latitude = pi * (static_cast<float>(ring) / static_cast<float>(rings) - 0.5F);
    for (int i = 0; i < segments; ++i) {
      const glm::vec3 normal =
          around(2.0F * pi * static_cast<float>(i) / static_cast<float>(segments),
                 std::cos(latitude), std::sin(latitude));
      add_vertex(mesh, radius * normal, normal);
    }
  }
  const std::uint32_t north = add_vertex(mesh, {0.0F, 0.0F, radius}, {0.0F, 0.0F, 1.0F});
  const auto at = [&](int ring, int i) {
    return static_cast<std::uint32_t>(1 + (ring - 1) * segments + i % segments);
  };
  for (int i = 0; i < segments; ++i) {
    add_triangle(mesh, south, at(1, i + 1), at(1, i));
    for (int ring = 1; ring + 1 < rings; ++ring) {
      add_triangle(mesh, at(ring, i), at(ring, i + 1), at(ring + 1, i + 1));
      add_triangle(mesh, at(ring, i), at(ring + 1, i + 1), at(ring + 1, i));
    }
    add_triangle(mesh, north, at(rings - 1, i), at(rings - 1, i + 1));
  }
  return as_model(std::move(mesh), "sphere", glm::vec3(-radius), glm::vec3(radius));
}

Model make_cylinder(float radius, float height, int segments) {
  PENUMBRA_ASSERT(radius > 0.0F && height > 0.0F && segments >= 3);
  Mesh mesh;
  const float pi = std::numbers::pi_v<float>;
  const std::uint32_t bottom = add_vertex(mesh, {0.0F, 0.0F, 0.0F}, {0.0F, 0.0F, -1.0F});
  const std::uint32_t top = add_vertex(mesh, {0.0F, 0.0F, height}, {0.0F, 0.0F, 1.0F});
  for (int i = 0; i < segments; ++i) {
    const float angle = 2.0F * pi * static_cast<float>(i) / static_cast<float>(segments);
    const glm::vec3 outward = around(angle, 1.0F, 0.0F);
    add_vertex(mesh, around(angle, radius, 0.0F), {0.0F, 0.0F, -1.0F});
    add_vertex(mesh, around(angle, radius, 0.0F), outward);
    add_vertex(mesh, around(angle, radius, height), outward);
    add_vertex(mesh, around(angle, radius, height), {0.0F, 0.0F, 1.0F});
  }
  const auto at = [&](int i, int k) {
    return static_cast<std::uint32_t>(2 + (i % segments) * 4 + k);
  };
  for (int i = 0; i < segments; ++i) {
    add_triangle(mesh, bottom, at(i + 1, 0), at(i, 0));
    add_triangle(mesh, at(i, 1), at(i + 1, 1), at(i + 1, 2));
    add_triangle(mesh, at(i, 1), at(i + 1, 2), at(i, 2));
    add_triangle(mesh, top, at(i, 3), at(i + 1, 3));
  }
  return as_model(std::move(mesh), "cylinder", {-radius, -radius, 0.0F}, {radius, radius, height});
}

}  // namespace penumbra
