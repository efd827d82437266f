#include "tools/models/solid.hpp"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <map>
#include <numbers>
#include <utility>

#include "core/assert.hpp"

namespace penumbra::models {
namespace {

std::uint32_t add(Solid& solid, const Point& point) {
  solid.points.push_back(point);
  return static_cast<std::uint32_t>(solid.points.size() - 1);
}

void triangle(Solid& solid, std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  solid.faces.push_back({{a, b, c}, 0});
}

// Splits the quad along its shorter diagonal.
void quad(Solid& solid, std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
  const double ac = glm::distance(solid.points[a], solid.points[c]);
  const double bd = glm::distance(solid.points[b], solid.points[d]);
  if (ac <= bd * (1.0 + 1e-9)) {
    triangle(solid, a, b, c);
    triangle(solid, a, c, d);
  } else {
    triangle(solid, a, b, d);
    triangle(solid, b, c, d);
  }
}

double signed_volume(const Solid& solid) {
  double sum = 0.0;
  for (const Face& face : solid.faces) {
    sum += glm::dot(solid.points[face.corners[0]],
                    glm::cross(solid.points[face.corners[1]], solid.points[face.corners[2]]));
  }
  return sum / 6.0;
}

void flip(Solid& solid) {
  for (Face& face : solid.faces) std::swap(face.corners[1], face.corners[2]);
}

Solid facing_out(Solid solid) {
  if (signed_volume(solid) < 0.0) flip(solid);
  return solid;
}

Point centre_of(const Points& ring) {
  Point sum(0.0);
  for (const Point& p : ring) sum += p;
  return sum / static_cast<double>(ring.size());
}

// Joins rows of vertex indices by quads. Rows and columns may be closed.
void join_rows(Solid& solid, const std::vector<std::vector<std::uint32_t>>& rows, bool closed) {
  const std::size_t last = closed ? rows.size() : rows.size() - 1;
  for (std::size_t r = 0; r < last; ++r) {
    const auto& a = rows[r];
    const auto& b = rows[(r + 1) % rows.size()];
    for (std::size_t i = 0; i < a.size(); ++i) {
      const std::size_t j = (i + 1) % a.size();
      quad(solid, a[i], a[j], b[j], b[i]);
    }
  }
}

std::vector<std::uint32_t> add_ring(Solid& solid, const Points& ring) {
  std::vector<std::uint32_t> row;
  for (const Point& p : ring) row.push_back(add(solid, p));
  return row;
}

Points circle(double radius, double z, int segments) {
  Points ring;
  for (int i = 0; i < segments; ++i) {
    const double turn = 2.0 * std::numbers::pi * i / segments;
    ring.emplace_back(radius * std::cos(turn), radius * std::sin(turn), z);
  }
  return ring;
}

}  // namespace

Solid loft(const std::vector<Points>& rings, const Point& first_centre, const Point& last_centre) {
  PENUMBRA_ASSERT(rings.size() >= 2);
  Solid solid;
  std::vector<std::vector<std::uint32_t>> rows;
  for (const Points& ring : rings) rows.push_back(add_ring(solid, ring));
  join_rows(solid, rows, false);
  const std::uint32_t first = add(solid, first_centre);
  const std::uint32_t last = add(solid, last_centre);
  for (std::size_t i = 0; i < rows.front().size(); ++i) {
    const std::size_t j = (i + 1) % rows.front().size();
    triangle(solid, rows.front()[j], rows.front()[i], first);
    triangle(solid, rows.back()[i], rows.back()[j], last);
  }
  return facing_out(std::move(solid));
}

Solid loft(const std::vector<Points>& rings) {
  return loft(rings, centre_of(rings.front()), centre_of(rings.back()));
}

Solid revolve(const std::vector<glm::dvec2>& profile, int segments) {
  PENUMBRA_ASSERT(profile.size() >= 4 && profile.front().x == 0.0 && profile.back().x == 0.0);
  std::vector<Points> rings;
  for (std::size_t i = 1; i + 1 < profile.size(); ++i)
    rings.push_back(circle(profile[i].x, profile[i].y, segments));
  return loft(rings, Point(0.0, 0.0, profile.front().y), Point(0.0, 0.0, profile.back().y));
}

Solid revolve_loop(const std::vector<glm::dvec2>& profile, int segments) {
  Solid solid;
  std::vector<std::vector<std::uint32_t>> rows;
  for (const glm::dvec2& p : profile) rows.push_back(add_ring(solid, circle(p.x, p.y, segments)));
  join_rows(solid, rows, true);
  return facing_out(std::move(solid));
}

Solid tube(const Points& path, const std::vector<double>& radii, int sides) {
  PENUMBRA_ASSERT(path.size() >= 2 && path.size() == radii.size());
  std::vector<Points> rings;
  Point side(0.0);
  for (std::size_t i = 0; i < path.size(); ++i) {
    const Point along =
        glm::normalize(path[std::min(i + 1, path.size() - 1)] - path[i == 0 ? 0 : i - 1]);
    if (i == 0) {
      side = std::abs(along.z) < 0.9 ? Point(0.0, 0.0, 1.0) : Point(1.0, 0.0, 0.0);
    }
    // Carries over the direction of the previous ring, so that the tube does not twist.
    side = glm::normalize(side - along * glm::dot(side, along));
    const Point other = glm::cross(along, side);
    Points ring;
    for (int k = 0; k < sides; ++k) {
      const double turn = 2.0 * std::numbers::pi * k / sides;
      ring.push_back(path[i] + radii[i] * (std::cos(turn) * side + std::sin(turn) * other));
    }
    rings.push_back(std::move(ring));
  }
  return loft(rings, path.front(), path.back());
}

Solid tube(const Points& path, double radius, int sides) {
  return tube(path, std::vector<double>(path.size(), radius), sides);
}

Solid sphere(const Point& centre, const Point& radii, int subdivisions) {
  // An icosahedron whose faces are split into four and projected onto the unit sphere.
  const double g = (1.0 + std::sqrt(5.0)) / 2.0;
  Solid solid;
  solid.points = {{-1, g, 0},  {1, g, 0},  {-1, -g, 0}, {1, -g, 0}, {0, -1, g},  {0, 1, g},
                  {0, -1, -g}, {0, 1, -g}, {g, 0, -1},  {g, 0, 1},  {-g, 0, -1}, {-g, 0, 1}};
  constexpr std::array<std::array<std::uint32_t, 3>, 20> kFaces = {
      {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
       {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
       {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}}};
  for (const auto& corners : kFaces) solid.faces.push_back({corners, 0});
  for (Point& p : solid.points) p = glm::normalize(p);
  for (int level = 0; level < subdivisions; ++level) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
    const auto middle = [&](std::uint32_t a, std::uint32_t b) {
      const auto [it, fresh] = middles.try_emplace(std::minmax(a, b), 0U);
      if (fresh) it->second = add(solid, glm::normalize(solid.points[a] + solid.points[b]));
      return it->second;
    };
    const std::vector<Face> coarse = std::exchange(solid.faces, {});
    for (const Face& face : coarse) {
      const auto [a, b, c] = face.corners;
      const std::uint32_t ab = middle(a, b);
      const std::uint32_t bc = middle(b, c);
      const std::uint32_t ca = middle(c, a);
      triangle(solid, a, ab, ca);
      triangle(solid, b, bc, ab);
      triangle(solid, c, ca, bc);
      triangle(solid, ab, bc, ca);
    }
  }
  for (Point& p : solid.points) p = centre + radii * p;
  return facing_out(std::move(solid));
}

Solid box(const Point& low, const Point& high) {
  Solid solid;
  std::array<std::uint32_t, 8> v{};
  for (unsigned i = 0; i < 8; ++i) {
    v[i] = add(solid, {(i & 1U) != 0 ? high.x : low.x, (i & 2U) != 0 ? high.y : low.y,
                       (i & 4U) != 0 ? high.z : low.z});
  }
  quad(solid, v[0], v[2], v[3], v[1]);
  quad(solid, v[4], v[5], v[7], v[6]);
  quad(solid, v[0], v[1], v[5], v[4]);
  quad(solid, v[2], v[6], v[7], v[3]);
  quad(solid, v[0], v[4], v[6], v[2]);
  quad(solid, v[1], v[3], v[7], v[5]);
  return solid;
}

Solid prism(const std::vector<glm::dvec2>& outline, const glm::dvec2& centre, double low,
            double high) {
  Points bottom;
  Points top;
  for (const glm::dvec2& p : outline) {
    bottom.emplace_back(p, low);
    top.emplace_back(p, high);
  }
  return loft({bottom, top}, Point(centre, low), Point(centre, high));
}

Points smooth_path(const Points& through, int steps) {
  // Barry and Goldman's pyramid with knots at the square root of the chord.
  const std::size_t n = through.size();
  PENUMBRA_ASSERT(n >= 2);
  Points path;
  for (std::size_t i = 0; i + 1 < n; ++i) {
    const Point p1 = through[i];
    const Point p2 = through[i + 1];
    const Point p0 = i == 0 ? 2.0 * p1 - p2 : through[i - 1];
    const Point p3 = i + 2 == n ? 2.0 * p2 - p1 : through[i + 2];
    const double t0 = 0.0;
    const double t1 = t0 + std::sqrt(glm::distance(p0, p1));
    const double t2 = t1 + std::sqrt(glm::distance(p1, p2));
    const double t3 = t2 + std::sqrt(glm::distance(p2, p3));
    const auto between = [](const Point& a, const Point& b, double ta, double tb, double t) {
      return a * ((tb - t) / (tb - ta)) + b * ((t - ta) / (tb - ta));
    };
    for (int k = 0; k < steps; ++k) {
      const double t = t1 + (t2 - t1) * k / steps;
      const Point a1 = between(p0, p1, t0, t1, t);
      const Point a2 = between(p1, p2, t1, t2, t);
      const Point a3 = between(p2, p3, t2, t3, t);
      const Point b1 = between(a1, a2, t0, t2, t);
      const Point b2 = between(a2, a3, t1, t3, t);
      path.push_back(between(b1, b2, t1, t2, t));
    }
  }
  path.push_back(through.back());
  return path;
}

Solid moved(Solid solid, const std::function<Point(const Point&)>& map) {
  for (Point& p : solid.points) p = map(p);
  return solid;
}

Solid turned_about_z(const Solid& solid, double angle_rad) {
  const double c = std::cos(angle_rad);
  const double s = std::sin(angle_rad);
  return moved(solid,
               [c, s](const Point& p) { return Point(c * p.x - s * p.y, s * p.x + c * p.y, p.z); });
}

Solid mirrored_y(const Solid& solid) {
  Solid other = moved(solid, [](const Point& p) { return Point(p.x, -p.y, p.z); });
  flip(other);
  return other;
}

Solid with_material(Solid solid, int material) {
  for (Face& face : solid.faces) face.material = material;
  return solid;
}

void append(Solid& to, const Solid& more) {
  const auto offset = static_cast<std::uint32_t>(to.points.size());
  to.points.insert(to.points.end(), more.points.begin(), more.points.end());
  for (Face face : more.faces) {
    for (std::uint32_t& corner : face.corners) corner += offset;
    to.faces.push_back(face);
  }
}

void cut(Solid& solid, const Field& field, double slide) {
  constexpr double kSlideShare = 0.25;  // fraction of an edge
  std::vector<double> value;
  for (const Point& p : solid.points) value.push_back(field(p));

  // Vertices close to the curve slide onto it, along the edge whose crossing with the curve is
  // nearest.
  struct Slide {
    double distance = 0.0;
    Point to = Point(0.0);
    bool found = false;
  };
  std::vector<Slide> slides(solid.points.size(), Slide{slide, Point(0.0), false});
  for (const Face& face : solid.faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t a = face.corners[k];
      const std::uint32_t b = face.corners[(k + 1) % 3];
      if (value[a] * value[b] >= 0.0) continue;
      const double length = glm::distance(solid.points[a], solid.points[b]);
      const double t = value[a] / (value[a] - value[b]);
      const Point at = solid.points[a] + t * (solid.points[b] - solid.points[a]);
      const auto offer = [&](std::uint32_t v, double share) {
        if (share < kSlideShare && share * length < slides[v].distance)
          slides[v] = {share * length, at, true};
      };
      offer(a, t);
      offer(b, 1.0 - t);
    }
  }
  for (std::size_t v = 0; v < slides.size(); ++v) {
    if (!slides[v].found) continue;
    solid.points[v] = slides[v].to;
    value[v] = 0.0;
  }

  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> crossings;
  const auto crossing = [&](std::uint32_t a, std::uint32_t b) {
    const std::pair<std::uint32_t, std::uint32_t> key = std::minmax(a, b);
    const auto [it, fresh] = crossings.try_emplace(key, 0U);
    if (fresh) {
      const auto [low, high] = key;
      const double t = value[low] / (value[low] - value[high]);
      it->second = add(solid, solid.points[low] + t * (solid.points[high] - solid.points[low]));
    }
    return it->second;
  };
  const std::vector<Face> whole = std::exchange(solid.faces, {});
  for (const Face& face : whole) {
    const std::size_t before = solid.faces.size();
    // Rotates the corners until the first one is alone on its side, or is on the curve with the
    // other two on opposite sides.
    std::array<std::uint32_t, 3> v = face.corners;
    bool split = false;
    for (int turn = 0; turn < 3 && !split; ++turn) {
      const double a = value[v[0]];
      const double b = value[v[1]];
      const double c = value[v[2]];
      if (a == 0.0 && b * c < 0.0) {
        const std::uint32_t m = crossing(v[1], v[2]);
        triangle(solid, v[0], v[1], m);
        triangle(solid, v[0], m, v[2]);
        split = true;
      } else if (a * b < 0.0 && a * c < 0.0) {
        const std::uint32_t m = crossing(v[0], v[1]);
        const std::uint32_t n = crossing(v[0], v[2]);
        triangle(solid, v[0], m, n);
        quad(solid, m, v[1], v[2], n);
        split = true;
      } else {
        std::rotate(v.begin(), v.begin() + 1, v.end());
      }
    }
    if (!split) triangle(solid, face.corners[0], face.corners[1], face.corners[2]);
    for (std::size_t i = before; i < solid.faces.size(); ++i)
      solid.faces[i].material = face.material;
  }
}

void refine(Solid& solid, const Field& field, double longest) {
  for (bool again = true; again;) {
    again = false;
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
    const auto long_inside = [&](std::uint32_t a, std::uint32_t b) {
      return glm::distance(solid.points[a], solid.points[b]) > longest &&
             field(0.5 * (solid.points[a] + solid.points[b])) < 0.0;
    };
    const auto middle = [&](std::uint32_t a, std::uint32_t b) {
      const auto [it, fresh] = middles.try_emplace(std::minmax(a, b), 0U);
      if (fresh) it->second = add(solid, 0.5 * (solid.points[a] + solid.points[b]));
      return it->second;
    };
    const std::vector<Face> coarse = std::exchange(solid.faces, {});
    for (const Face& face : coarse) {
      const std::size_t before = solid.faces.size();
      std::array<std::uint32_t, 3> v = face.corners;
      std::array<bool, 3> split{};  // the edge from corner k to the next
      for (std::size_t k = 0; k < 3; ++k) split[k] = long_inside(v[k], v[(k + 1) % 3]);
      const auto count = std::count(split.begin(), split.end(), true);
      again = again || count > 0;
      // Rotates until the first edge is split and, if two are split, the last one is not.
      while (count > 0 && count < 3 && !(split[0] && !split[2])) {
        std::rotate(v.begin(), v.begin() + 1, v.end());
        std::rotate(split.begin(), split.begin() + 1, split.end());
      }
      if (count == 0) {
        triangle(solid, v[0], v[1], v[2]);
      } else if (count == 1) {
        const std::uint32_t m = middle(v[0], v[1]);
        triangle(solid, v[0], m, v[2]);
        triangle(solid, m, v[1], v[2]);
      } else if (count == 2) {
        const std::uint32_t m = middle(v[0], v[1]);
        const std::uint32_t n = middle(v[1], v[2]);
        triangle(solid, m, v[1], n);
        quad(solid, v[0], m, n, v[2]);
      } else {
        const std::uint32_t m = middle(v[0], v[1]);
        const std::uint32_t n = middle(v[1], v[2]);
        const std::uint32_t o = middle(v[2], v[0]);
        triangle(solid, v[0], m, o);
        triangle(solid, m, v[1], n);
        triangle(solid, o, n, v[2]);
        triangle(solid, m, n, o);
      }
      for (std::size_t i = before; i < solid.faces.size(); ++i)
        solid.faces[i].material = face.material;
    }
  }
}

void recolor(Solid& solid, const Field& field, int material) {
  for (Face& face : solid.faces) {
    const Point centre = (solid.points[face.corners[0]] + solid.points[face.corners[1]] +
                          solid.points[face.corners[2]]) /
                         3.0;
    if (field(centre) < 0.0) face.material = material;
  }
}

void paint(Solid& solid, const Field& field, int material) {
  cut(solid, field);
  recolor(solid, field, material);
}

void paint_band(Solid& solid, const Field& field, double half_width, int material) {
  const double slide = std::min(0.4, half_width);
  cut(
      solid, [&](const Point& p) { return field(p) - half_width; }, slide);
  cut(
      solid, [&](const Point& p) { return field(p) + half_width; }, slide);
  recolor(
      solid, [&](const Point& p) { return std::abs(field(p)) - half_width; }, material);
}

double rounded_polygon(const std::vector<glm::dvec2>& corners, double radius, const glm::dvec2& p) {
  // The nearest segment gives the distance to the outline; the number of crossings gives its sign.
  double nearest = glm::distance(p, corners.front());
  bool inside = false;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const glm::dvec2 a = corners[i];
    const glm::dvec2 b = corners[(i + 1) % corners.size()];
    const glm::dvec2 edge = b - a;
    const double t = std::clamp(glm::dot(p - a, edge) / glm::dot(edge, edge), 0.0, 1.0);
    nearest = std::min(nearest, glm::distance(p, a + t * edge));
    if ((a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * edge.x)
      inside = !inside;
  }
  return (inside ? -nearest : nearest) - radius;
}

namespace {

double rounded_to(double value, double unit) {
  const double rounded = std::round(value / unit) * unit;
  return rounded == 0.0 ? 0.0 : rounded;  // no negative zero
}

glm::vec3 rounded_to(const Point& p, double unit) {
  return {static_cast<float>(rounded_to(p.x, unit)), static_cast<float>(rounded_to(p.y, unit)),
          static_cast<float>(rounded_to(p.z, unit))};
}

}  // namespace

void add_part(Model& model, const std::string& name, const Solid& solid, double crease_deg) {
  const double crease_cos = std::cos(crease_deg * std::numbers::pi / 180.0);
  std::vector<Point> face_normal;
  std::vector<std::vector<std::size_t>> faces_round(solid.points.size());
  for (std::size_t f = 0; f < solid.faces.size(); ++f) {
    const auto& [a, b, c] = solid.faces[f].corners;
    const Point n =
        glm::cross(solid.points[b] - solid.points[a], solid.points[c] - solid.points[a]);
    const double length = glm::length(n);
    PENUMBRA_ASSERT(length > 0.0);
    face_normal.push_back(n / length);
    for (const std::uint32_t corner : solid.faces[f].corners) faces_round[corner].push_back(f);
  }
  const auto angle_at = [&](std::size_t f, std::uint32_t v) {
    const auto& corners = solid.faces[f].corners;
    const std::size_t k =
        static_cast<std::size_t>(std::find(corners.begin(), corners.end(), v) - corners.begin());
    const Point at = solid.points[v];
    const Point to = glm::normalize(solid.points[corners[(k + 1) % 3]] - at);
    const Point from = glm::normalize(solid.points[corners[(k + 2) % 3]] - at);
    return std::acos(std::clamp(glm::dot(to, from), -1.0, 1.0));
  };

  const std::size_t first_mesh = model.meshes.size();
  std::map<int, std::size_t> mesh_of_material;
  std::map<std::array<float, 7>, std::uint32_t> known;  // position, normal, material
  for (std::size_t f = 0; f < solid.faces.size(); ++f) {
    const Face& face = solid.faces[f];
    const auto [it, fresh] = mesh_of_material.try_emplace(face.material, model.meshes.size());
    if (fresh) {
      Mesh mesh;
      mesh.name = name;
      mesh.material = face.material;
      model.meshes.push_back(std::move(mesh));
    }
    Mesh& mesh = model.meshes[it->second];
    for (const std::uint32_t corner : face.corners) {
      Point normal(0.0);
      for (const std::size_t other : faces_round[corner]) {
        if (glm::dot(face_normal[f], face_normal[other]) >= crease_cos)
          normal += angle_at(other, corner) * face_normal[other];
      }
      const glm::vec3 n = rounded_to(glm::normalize(normal), 1e-5);
      const glm::vec3 p = rounded_to(solid.points[corner] * 1e-3, 1e-6);
      const auto [vertex, unseen] =
          known.try_emplace({p.x, p.y, p.z, n.x, n.y, n.z, static_cast<float>(face.material)},
                            static_cast<std::uint32_t>(mesh.positions.size()));
      if (unseen) {
        mesh.positions.push_back(p);
        mesh.normals.push_back(n);
      }
      mesh.indices.push_back(vertex->second);
    }
  }
  for (std::size_t m = first_mesh; m < model.meshes.size(); ++m) {
    for (const glm::vec3& p : model.meshes[m].positions) {
      const bool first = model.source_vertex_count == 0;
      model.min_corner = first ? p : glm::min(model.min_corner, p);
      model.max_corner = first ? p : glm::max(model.max_corner, p);
      model.meshes[m].source_vertex.push_back(model.source_vertex_count++);
    }
  }
}

int add_material(Model& model, const std::string& name, const glm::vec3& linear_color,
                 float metallic, float roughness, const glm::vec3& emissive) {
  Material material;
  material.name = name;
  material.base_color = glm::vec4(linear_color, 1.0F);
  material.metallic = metallic;
  material.roughness = roughness;
  material.emissive = emissive;
  model.materials.push_back(std::move(material));
  return static_cast<int>(model.materials.size() - 1);
}

}  // namespace penumbra::models
