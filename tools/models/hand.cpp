// An open right hand on its wrist: one closed surface, meshed from a distance field.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <vector>

#include "tools/models/bundled_models.hpp"
#include "tools/models/solid.hpp"

namespace penumbra::models {
namespace {

struct Bone {
  Point from, to;
  double radius_from, radius_to;  // [mm]
};

double distance_to(const Bone& bone, const Point& p) {
  const Point along = bone.to - bone.from;
  const double t = std::clamp(glm::dot(p - bone.from, along) / glm::dot(along, along), 0.0, 1.0);
  return glm::distance(p, bone.from + t * along) -
         (bone.radius_from + t * (bone.radius_to - bone.radius_from));
}

// Union of two distances with a fillet of about `k` millimetres.
double blend(double a, double b, double k) {
  const double h = std::max(k - std::abs(a - b), 0.0) / k;
  return std::min(a, b) - 0.25 * k * h * h;
}

double hand_distance(const Point& p) {
  static const std::vector<Bone> kPalm = {{{0.0, 0.0, -6.0}, {0.0, 0.0, 14.0}, 13.0, 12.5},
                                          {{-8.0, 0.0, 16.0}, {-17.0, 0.0, 56.0}, 9.5, 8.0},
                                          {{-3.0, -0.5, 16.0}, {-5.5, -1.2, 59.0}, 9.5, 8.2},
                                          {{3.0, -0.5, 16.0}, {6.0, -0.8, 57.0}, 9.5, 7.8},
                                          {{8.0, 0.5, 16.0}, {17.0, 0.8, 51.0}, 9.5, 7.0},
                                          {{-8.0, 3.0, 18.0}, {-19.0, 6.0, 34.0}, 10.0, 9.0}};
  static const std::vector<std::vector<Bone>> kFingers = {
      {{{-19.0, 6.0, 34.0}, {-33.0, 9.0, 50.0}, 8.6, 7.2},
       {{-33.0, 9.0, 50.0}, {-40.0, 11.0, 64.0}, 7.2, 5.6}},
      {{{-17.0, 0.0, 56.0}, {-23.5, 0.5, 80.0}, 7.4, 6.4},
       {{-23.5, 0.5, 80.0}, {-27.0, 3.0, 94.0}, 6.4, 5.8},
       {{-27.0, 3.0, 94.0}, {-29.0, 6.5, 104.0}, 5.8, 5.0}},
      {{{-5.5, -1.2, 59.0}, {-7.5, -0.6, 87.0}, 7.6, 6.6},
       {{-7.5, -0.6, 87.0}, {-8.5, 2.2, 103.0}, 6.6, 6.0},
       {{-8.5, 2.2, 103.0}, {-9.0, 6.0, 113.0}, 6.0, 5.1}},
      {{{6.0, -0.8, 57.0}, {10.0, 0.0, 83.0}, 7.2, 6.3},
       {{10.0, 0.0, 83.0}, {12.0, 3.0, 97.0}, 6.3, 5.8},
       {{12.0, 3.0, 97.0}, {13.0, 6.8, 107.0}, 5.8, 4.9}},
      {{{17.0, 0.8, 51.0}, {25.5, 2.2, 71.0}, 6.4, 5.5},
       {{25.5, 2.2, 71.0}, {29.5, 4.8, 81.0}, 5.5, 5.0},
       {{29.5, 4.8, 81.0}, {32.0, 8.0, 89.0}, 5.0, 4.3}}};
  double d = distance_to(kPalm.front(), p);
  for (const Bone& bone : kPalm) d = blend(d, distance_to(bone, p), 7.0);
  for (const std::vector<Bone>& finger : kFingers) {
    double f = distance_to(finger.front(), p);
    for (const Bone& bone : finger) f = std::min(f, distance_to(bone, p));
    d = blend(d, f, 5.0);
  }
  return -blend(-d, p.z, 3.0);  // a flat wrist to stand on
}

// Surface nets: creates a vertex in each cell and a quad across each grid edge that the surface
// crosses. The vertices are then moved onto the surface.
Solid mesh_of(const Field& field, const Point& low, const Point& high, double cell) {
  const glm::ivec3 size = glm::ivec3(glm::ceil((high - low) / cell)) + 1;
  const auto index = [&size](const glm::ivec3& c) {
    return static_cast<std::size_t>((c.z * size.y + c.y) * size.x + c.x);
  };
  const auto place = [&](const glm::ivec3& c) { return low + cell * Point(c); };
  std::vector<double> value(index({0, 0, size.z}));
  for (int z = 0; z < size.z; ++z)
    for (int y = 0; y < size.y; ++y)
      for (int x = 0; x < size.x; ++x) value[index({x, y, z})] = field(place({x, y, z}));

  Solid solid;
  constexpr std::uint32_t kNone = UINT32_MAX;
  std::vector<std::uint32_t> vertex(value.size(), kNone);
  for (int z = 0; z + 1 < size.z; ++z) {
    for (int y = 0; y + 1 < size.y; ++y) {
      for (int x = 0; x + 1 < size.x; ++x) {
        Point sum(0.0);
        int crossings = 0;
        for (int axis = 0; axis < 3; ++axis) {
          for (int corner = 0; corner < 4; ++corner) {
            glm::ivec3 a(x, y, z);
            a[(axis + 1) % 3] += corner & 1;
            a[(axis + 2) % 3] += corner >> 1;
            glm::ivec3 b = a;
            ++b[axis];
            const double va = value[index(a)];
            const double vb = value[index(b)];
            if ((va < 0.0) == (vb < 0.0)) continue;
            sum += place(a) + va / (va - vb) * (place(b) - place(a));
            ++crossings;
          }
        }
        if (crossings == 0) continue;
        vertex[index({x, y, z})] = static_cast<std::uint32_t>(solid.points.size());
        solid.points.push_back(sum / static_cast<double>(crossings));
      }
    }
  }
  for (int z = 1; z + 1 < size.z; ++z) {
    for (int y = 1; y + 1 < size.y; ++y) {
      for (int x = 1; x + 1 < size.x; ++x) {
        for (int axis = 0; axis < 3; ++axis) {
          const glm::ivec3 a(x, y, z);
          glm::ivec3 b = a;
          ++b[axis];
          const bool inside = value[index(a)] < 0.0;
          if (inside == (value[index(b)] < 0.0)) continue;
          std::array<std::uint32_t, 4> v{};
          for (std::size_t k = 0; k < 4; ++k) {
            glm::ivec3 c = a;
            if (k == 0 || k == 3) --c[(axis + 1) % 3];
            if (k == 0 || k == 1) --c[(axis + 2) % 3];
            v[k] = vertex[index(c)];
          }
          if (!inside) std::swap(v[1], v[3]);
          solid.faces.push_back({{v[0], v[1], v[2]}, 0});
          solid.faces.push_back({{v[0], v[2], v[3]}, 0});
        }
      }
    }
  }
  for (Point& p : solid.points) {
    for (int step = 0; step < 2; ++step) {
      constexpr double kStep = 1e-3;
      const Point slope = Point(field(p + Point(kStep, 0, 0)) - field(p - Point(kStep, 0, 0)),
                                field(p + Point(0, kStep, 0)) - field(p - Point(0, kStep, 0)),
                                field(p + Point(0, 0, kStep)) - field(p - Point(0, 0, kStep))) /
                          (2.0 * kStep);
      p -= field(p) * slope / glm::dot(slope, slope);
    }
  }
  return solid;
}

}  // namespace

Model make_hand() {
  Model model;
  model.name = "hand";
  add_material(model, "skin", {0.70F, 0.36F, 0.23F}, 0.0F, 0.6F);
  add_part(model, "hand", mesh_of(hand_distance, {-52.3, -24.1, -5.9}, {44.0, 30.0, 126.0}, 4.1),
           75.0);
  return model;
}

}  // namespace penumbra::models
