// Writes the models that ship with penumbra: make_models FOLDER. The same bytes every time.
// Every part is a closed body lofted through rings of points, in the object frame (metres, z up,
// nose along +x); files are glTF, so y up.
#include <tiny_gltf.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <functional>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <map>
#include <numbers>
#include <string>
#include <vector>

namespace {

using glm::dvec3;
constexpr double kPi = std::numbers::pi;

enum Paint { red, white, navy, glass, dark, metal, yellow, paint_count };

struct PaintLook {
  const char* name;
  std::array<double, 3> color;  // linear
  double metallic, roughness;
};
constexpr std::array<PaintLook, paint_count> kPaints = {{
    {"red", {0.62, 0.03, 0.02}, 0.0, 0.35},
    {"white", {0.86, 0.85, 0.80}, 0.0, 0.4},
    {"navy", {0.02, 0.04, 0.16}, 0.0, 0.4},
    {"glass", {0.03, 0.09, 0.14}, 0.3, 0.08},
    {"dark", {0.03, 0.03, 0.035}, 0.0, 0.7},
    {"metal", {0.42, 0.43, 0.45}, 0.8, 0.35},
    {"yellow", {0.85, 0.52, 0.02}, 0.0, 0.45},
}};

struct Face {
  std::array<std::size_t, 3> corner;
  Paint paint;
};

struct Part {
  std::vector<dvec3> points;
  std::vector<Face> faces;
  double crease_deg = 45.0;
};

using Ring = std::vector<dvec3>;
// Which paint the face has whose middle is here.
using Painter = std::function<Paint(const dvec3&)>;

Painter all(Paint paint) {
  return [paint](const dvec3&) { return paint; };
}

// A closed body: quads between neighbouring rings, a fan at each end.
Part loft(const std::vector<Ring>& rings, const Painter& painter, double crease_deg = 45.0) {
  Part part;
  part.crease_deg = crease_deg;
  const std::size_t n = rings.front().size();
  for (const Ring& ring : rings) part.points.insert(part.points.end(), ring.begin(), ring.end());
  const auto add = [&](std::size_t a, std::size_t b, std::size_t c) {
    const dvec3 middle = (part.points[a] + part.points[b] + part.points[c]) / 3.0;
    part.faces.push_back({{a, b, c}, painter(middle)});
  };
  for (std::size_t r = 0; r + 1 < rings.size(); ++r) {
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t j = (i + 1) % n;
      const std::size_t a = r * n + i, b = r * n + j, c = a + n, d = b + n;
      // Both triangles of a quad have one paint.
      const Paint paint =
          painter((part.points[a] + part.points[b] + part.points[c] + part.points[d]) / 4.0);
      part.faces.push_back({{a, b, d}, paint});
      part.faces.push_back({{a, d, c}, paint});
    }
  }
  for (const bool last : {false, true}) {
    const std::size_t first = last ? (rings.size() - 1) * n : 0;
    dvec3 centre(0.0);
    for (std::size_t i = 0; i < n; ++i) centre += part.points[first + i] / static_cast<double>(n);
    part.points.push_back(centre);
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t a = first + i, b = first + (i + 1) % n;
      if (last) {
        add(a, b, part.points.size() - 1);
      } else {
        add(b, a, part.points.size() - 1);
      }
    }
  }
  // Outwards: the body's volume, summed over its faces, is positive.
  double volume = 0.0;
  for (const Face& face : part.faces) {
    volume += glm::dot(part.points[face.corner[0]],
                       glm::cross(part.points[face.corner[1]], part.points[face.corner[2]]));
  }
  if (volume < 0.0) {
    for (Face& face : part.faces) std::swap(face.corner[1], face.corner[2]);
  }
  return part;
}

// A superellipse about `centre`, half axes a and b; power 2 is an ellipse, more is boxier.
Ring superellipse(const dvec3& centre, const dvec3& a, const dvec3& b, double power, int count) {
  Ring ring;
  for (int i = 0; i < count; ++i) {
    const double t = 2.0 * kPi * (i + 0.5) / count;
    const auto bent = [power](double x) {
      return std::copysign(std::pow(std::abs(x), 2.0 / power), x);
    };
    ring.push_back(centre + a * bent(std::cos(t)) + b * bent(std::sin(t)));
  }
  return ring;
}

// A round bar along a path.
Part tube(const std::vector<dvec3>& path, double radius, const Painter& painter, int sides = 10) {
  std::vector<Ring> rings;
  dvec3 side(0.0);
  for (std::size_t i = 0; i < path.size(); ++i) {
    const dvec3 along =
        glm::normalize(path[std::min(i + 1, path.size() - 1)] - path[i == 0 ? 0 : i - 1]);
    if (i == 0) side = std::abs(along.z) < 0.9 ? dvec3(0, 0, 1) : dvec3(1, 0, 0);
    side = glm::normalize(side - along * glm::dot(side, along));
    rings.push_back(
        superellipse(path[i], side * radius, glm::cross(along, side) * radius, 2.0, sides));
  }
  return loft(rings, painter, 60.0);
}

double eased(double from, double to, double x) {
  const double t = std::clamp((x - from) / (to - from), 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

// Stations along x: interpolated by Catmull-Rom, so that the outline is smooth.
struct Station {
  double x, z, half_width, half_height, power;
};

Station between(const std::vector<Station>& s, double at) {
  const auto i = std::min(static_cast<std::size_t>(at), s.size() - 2);
  const double t = at - static_cast<double>(i);
  const Station &p0 = s[i == 0 ? 0 : i - 1], &p1 = s[i], &p2 = s[i + 1],
                &p3 = s[std::min(i + 2, s.size() - 1)];
  const auto mix = [&](double Station::*m) {
    return 0.5 * (2.0 * p1.*m + (p2.*m - p0.*m) * t +
                  (2.0 * p0.*m - 5.0 * p1.*m + 4.0 * p2.*m - p3.*m) * t * t +
                  (3.0 * p1.*m - p0.*m - 3.0 * p2.*m + p3.*m) * t * t * t);
  };
  return {mix(&Station::x), mix(&Station::z), mix(&Station::half_width), mix(&Station::half_height),
          mix(&Station::power)};
}

Paint fuselage_paint(const dvec3& p) {
  // Windscreen: the upper front, behind a line that leans back; a post at the door.
  const bool front = p.x > 0.0135 && p.x < 0.0415;
  const double sill = 0.0262 - 0.10 * (p.x - 0.02);
  if (front && p.z > sill && p.z < 0.0432) {
    const bool post = std::abs(p.x - 0.0215) < 0.0013 || std::abs(p.y) < 0.0012;
    return post ? white : glass;
  }
  // Door window.
  if (p.x > -0.0035 && p.x < 0.0105 && p.z > 0.0275 && p.z < 0.0375) return glass;
  if (p.x < -0.062 && p.x > -0.069) return white;  // band on the boom
  const double stripe = 0.0215 + 0.10 * eased(0.0, -0.05, p.x) * 0.08;
  if (p.z < stripe - 0.0016) return p.x > -0.03 ? white : red;
  if (p.z < stripe + 0.0022 && p.x > -0.03) return navy;
  return red;
}

std::vector<Part> helicopter() {
  std::vector<Part> parts;
  const std::vector<Station> body = {
      {0.0470, 0.0205, 0.0015, 0.0015, 2.0},  {0.0455, 0.0207, 0.0062, 0.0058, 2.0},
      {0.0410, 0.0220, 0.0112, 0.0108, 2.1},  {0.0330, 0.0247, 0.0152, 0.0152, 2.2},
      {0.0220, 0.0275, 0.0175, 0.0182, 2.4},  {0.0100, 0.0285, 0.0182, 0.0190, 2.5},
      {-0.0040, 0.0287, 0.0180, 0.0186, 2.5}, {-0.0160, 0.0300, 0.0158, 0.0163, 2.4},
      {-0.0260, 0.0322, 0.0115, 0.0120, 2.2}, {-0.0350, 0.0343, 0.0074, 0.0080, 2.0},
      {-0.0450, 0.0358, 0.0050, 0.0055, 2.0}, {-0.0600, 0.0370, 0.0039, 0.0043, 2.0},
      {-0.0740, 0.0381, 0.0031, 0.0034, 2.0}, {-0.0790, 0.0385, 0.0022, 0.0024, 2.0}};
  std::vector<Ring> rings;
  constexpr int kPerStation = 3;
  const int steps = static_cast<int>(body.size() - 1) * kPerStation;
  for (int i = 0; i <= steps; ++i) {
    const Station s = between(body, static_cast<double>(i) / kPerStation);
    rings.push_back(
        superellipse({s.x, 0, s.z}, {0, s.half_width, 0}, {0, 0, s.half_height}, s.power, 28));
  }
  parts.push_back(loft(rings, fuselage_paint, 60.0));

  // Engine cowling over the cabin.
  rings.clear();
  for (int i = 0; i <= 12; ++i) {
    const double t = -1.0 + 2.0 * i / 12.0;
    const double r = std::sqrt(std::max(0.0, 1.0 - std::pow(std::abs(t), 2.6))) + 0.04;
    rings.push_back(superellipse({-0.006 - 0.0185 * t, 0, 0.0448 - 0.0012 * t}, {0, 0.0095 * r, 0},
                                 {0, 0, 0.0060 * r}, 2.4, 20));
  }
  parts.push_back(loft(
      rings, [](const dvec3& p) { return p.x > 0.0085 ? dark : red; }, 60.0));
  parts.push_back(tube({{-0.002, 0, 0.046}, {-0.002, 0, 0.0605}}, 0.0017, all(metal), 12));
  for (const double side : {-1.0, 1.0}) {
    parts.push_back(tube({{-0.0175, side * 0.0060, 0.0462},
                          {-0.0225, side * 0.0078, 0.0472},
                          {-0.0265, side * 0.0098, 0.0486}},
                         0.0023, all(metal), 12));
  }

  // Fin: swept back, thick in the middle, its chord shorter to the top; a stub below.
  const auto slab = [](const dvec3& root, const dvec3& tip, const dvec3& chord_root,
                       const dvec3& chord_tip, const dvec3& thick, double thickness,
                       const Painter& painter, int sections) {
    std::vector<Ring> ring;
    for (int i = 0; i <= sections; ++i) {
      const double t = static_cast<double>(i) / sections;
      // Rounded off at the tips.
      const double e = std::sqrt(std::max(0.06, 1.0 - std::pow(std::abs(2.0 * t - 1.0), 10.0)));
      ring.push_back(superellipse(root + (tip - root) * t,
                                  (chord_root + (chord_tip - chord_root) * t) * (0.5 * e),
                                  thick * (0.5 * thickness * e), 2.4, 16));
    }
    return loft(ring, painter, 60.0);
  };
  parts.push_back(slab(
      {-0.0735, 0, 0.0330}, {-0.0845, 0, 0.0625}, {0.0150, 0, 0}, {0.0075, 0, 0}, {0, 1, 0}, 0.0022,
      [](const dvec3& p) { return p.z > 0.0560   ? white
                                  : p.z > 0.0525 ? navy
                                                 : red; }, 18));
  parts.push_back(slab(
      {-0.0615, -0.0185, 0.0372}, {-0.0615, 0.0185, 0.0372}, {0.0085, 0, 0}, {0.0085, 0, 0},
      {0, 0, 1}, 0.0016, [](const dvec3& p) { return std::abs(p.y) > 0.0140 ? white : red; }, 20));
  for (const double side : {-1.0, 1.0}) {
    parts.push_back(slab({-0.0630, side * 0.0187, 0.0322}, {-0.0640, side * 0.0187, 0.0432},
                         {0.0090, 0, 0}, {0.0070, 0, 0}, {0, 1, 0}, 0.0013, all(red), 8));
  }
  parts.push_back(
      tube({{-0.0815, -0.0008, 0.0560}, {-0.0815, 0.0042, 0.0560}}, 0.0013, all(metal), 10));

  // Skids with their toes turned up, on four struts.
  for (const double side : {-1.0, 1.0}) {
    std::vector<dvec3> path;
    for (int i = 0; i <= 18; ++i) {
      const double x = -0.031 + 0.0725 * i / 18.0;
      const double toe = std::max(0.0, (x - 0.026) / 0.0155);
      path.emplace_back(x, side * 0.0195, 0.0013 + 0.0060 * toe * toe);
    }
    parts.push_back(tube(path, 0.0013, all(dark)));
    for (const double x : {0.0190, -0.0130}) {
      std::vector<dvec3> strut;
      for (int i = 0; i <= 6; ++i) {
        const double t = i / 6.0;
        strut.emplace_back(x, side * (0.0080 + 0.0115 * std::sin(t * kPi / 2.0)),
                           0.0140 - 0.0127 * (1.0 - std::cos(t * kPi / 2.0)));
      }
      parts.push_back(tube(strut, 0.0010, all(metal)));
    }
  }
  // Searchlight under the nose, and a beacon on the back.
  parts.push_back(tube(
      {{0.0335, 0, 0.0105}, {0.0385, 0, 0.0095}}, 0.0030,
      [](const dvec3& p) { return p.x > 0.0384 ? yellow : dark; }, 14));
  parts.push_back(tube({{-0.0290, 0, 0.0405}, {-0.0290, 0, 0.0452}}, 0.0016, all(yellow), 10));
  return parts;
}

// A blade outwards along `out`, chord along `across`, twisted like a real one.
Part blade(const dvec3& out, const dvec3& across, const dvec3& up, double from, double to,
           double chord, double thickness, double pitch_deg) {
  std::vector<Ring> rings;
  constexpr int kSections = 10;
  for (int i = 0; i <= kSections; ++i) {
    const double t = static_cast<double>(i) / kSections;
    const double pitch = pitch_deg * (1.0 - 0.5 * t) * kPi / 180.0;
    const double end = i == 0 || i == kSections ? 0.55 : 1.0;
    const double root = 0.45 + 0.55 * eased(0.0, 0.22, t);
    const dvec3 along_chord = across * std::cos(pitch) + up * std::sin(pitch);
    const dvec3 normal = up * std::cos(pitch) - across * std::sin(pitch);
    rings.push_back(superellipse(out * (from + (to - from) * t) + up * (-0.0016 * t * t),
                                 along_chord * (0.5 * chord * root * end),
                                 normal * (0.5 * thickness * end), 2.2, 12));
  }
  return loft(
      rings,
      [&](const dvec3& p) {
        const double r = glm::dot(p, out) / to;
        return r > 0.90 ? yellow : r > 0.84 ? white : dark;
      },
      60.0);
}

// About its own origin, turning about z.
std::vector<Part> main_rotor() {
  std::vector<Part> parts;
  parts.push_back(tube({{0, 0, -0.0012}, {0, 0, 0.0022}}, 0.0042, all(metal), 18));
  parts.push_back(tube({{0, 0, 0.0020}, {0, 0, 0.0036}}, 0.0022, all(red), 14));
  for (int i = 0; i < 4; ++i) {
    const double angle = kPi / 2.0 * i + kPi / 8.0;
    const dvec3 out(std::cos(angle), std::sin(angle), 0.0);
    const dvec3 across(-std::sin(angle), std::cos(angle), 0.0);
    parts.push_back(blade(out, across, {0, 0, 1}, 0.0030, 0.0620, 0.0066, 0.0012, 8.0));
  }
  return parts;
}

// About its own origin, turning about y.
std::vector<Part> tail_rotor() {
  std::vector<Part> parts;
  parts.push_back(tube({{0, -0.0010, 0}, {0, 0.0014, 0}}, 0.0018, all(metal), 12));
  for (int i = 0; i < 3; ++i) {
    const double angle = 2.0 * kPi / 3.0 * i + kPi / 6.0;
    const dvec3 out(std::cos(angle), 0.0, std::sin(angle));
    const dvec3 across(-std::sin(angle), 0.0, std::cos(angle));
    parts.push_back(blade(out, across, {0, 1, 0}, 0.0010, 0.0125, 0.0032, 0.0008, 8.0));
  }
  return parts;
}

// --- writing ---

struct Primitive {
  std::vector<float> positions, normals;
  std::vector<std::uint16_t> indices;
  std::map<std::array<std::int64_t, 7>, std::uint16_t> known;
};

std::array<Primitive, paint_count> primitives(const std::vector<Part>& parts) {
  std::array<Primitive, paint_count> result;
  for (std::size_t p = 0; p < parts.size(); ++p) {
    const Part& part = parts[p];
    std::vector<dvec3> normal(part.faces.size());
    std::vector<std::vector<std::size_t>> at_point(part.points.size());
    for (std::size_t f = 0; f < part.faces.size(); ++f) {
      const auto& c = part.faces[f].corner;
      normal[f] = glm::normalize(
          glm::cross(part.points[c[1]] - part.points[c[0]], part.points[c[2]] - part.points[c[0]]));
      for (const std::size_t corner : c) at_point[corner].push_back(f);
    }
    const double crease = std::cos(part.crease_deg * kPi / 180.0);
    for (std::size_t f = 0; f < part.faces.size(); ++f) {
      Primitive& to = result[part.faces[f].paint];
      for (const std::size_t corner : part.faces[f].corner) {
        dvec3 sum(0.0);
        for (const std::size_t other : at_point[corner]) {
          if (glm::dot(normal[other], normal[f]) >= crease) {
            const auto& c = part.faces[other].corner;
            sum += glm::cross(part.points[c[1]] - part.points[c[0]],
                              part.points[c[2]] - part.points[c[0]]);
          }
        }
        sum = glm::normalize(sum);
        const dvec3& point = part.points[corner];
        std::array<std::int64_t, 7> key{};
        for (int i = 0; i < 3; ++i) {
          key[static_cast<std::size_t>(i)] = std::llround(point[i] * 1e7);
          key[static_cast<std::size_t>(i) + 3] = std::llround(sum[i] * 1e4);
        }
        key[6] = static_cast<std::int64_t>(p);
        const auto [entry, is_new] =
            to.known.try_emplace(key, static_cast<std::uint16_t>(to.positions.size() / 3));
        if (is_new) {
          // To tenths of a micrometre: the last bits of sin and cos never reach the file. z up ->
          // y up.
          const auto at = [&key](std::size_t i) {
            return static_cast<float>(1e-7 * static_cast<double>(key[i]));
          };
          to.positions.insert(to.positions.end(), {at(0), at(2), -at(1)});
          const dvec3 n = glm::normalize(dvec3(key[3], key[4], key[5]));
          to.normals.insert(to.normals.end(), {static_cast<float>(n.x), static_cast<float>(n.z),
                                               static_cast<float>(-n.y)});
        }
        to.indices.push_back(entry->second);
      }
    }
  }
  return result;
}

template <class T>
int add_accessor(tinygltf::Model& model, const std::vector<T>& values, int component, int type,
                 std::size_t width) {
  std::vector<unsigned char>& data = model.buffers[0].data;
  while (data.size() % 4 != 0) data.push_back(0);
  tinygltf::BufferView view;
  view.buffer = 0;
  view.byteOffset = data.size();
  view.byteLength = values.size() * sizeof(T);
  view.target = type == TINYGLTF_TYPE_SCALAR ? TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER
                                             : TINYGLTF_TARGET_ARRAY_BUFFER;
  data.resize(data.size() + view.byteLength);
  std::memcpy(data.data() + view.byteOffset, values.data(), view.byteLength);
  model.bufferViews.push_back(view);
  tinygltf::Accessor accessor;
  accessor.bufferView = static_cast<int>(model.bufferViews.size()) - 1;
  accessor.componentType = component;
  accessor.type = type;
  accessor.count = values.size() / width;
  if (type == TINYGLTF_TYPE_VEC3) {
    for (std::size_t c = 0; c < 3; ++c) {
      double low = 1e9, high = -1e9;
      for (std::size_t i = c; i < values.size(); i += 3) {
        low = std::min(low, static_cast<double>(values[i]));
        high = std::max(high, static_cast<double>(values[i]));
      }
      accessor.minValues.push_back(low);
      accessor.maxValues.push_back(high);
    }
  }
  model.accessors.push_back(accessor);
  return static_cast<int>(model.accessors.size()) - 1;
}

bool write(const std::string& file, const std::string& name, const std::vector<Part>& parts) {
  tinygltf::Model model;
  model.asset.version = "2.0";
  model.asset.generator = "penumbra make_models";
  model.buffers.emplace_back();
  tinygltf::Mesh mesh;
  mesh.name = name;
  std::size_t triangles = 0;
  const auto prims = primitives(parts);
  for (std::size_t paint = 0; paint < paint_count; ++paint) {
    const Primitive& from = prims[paint];
    if (from.indices.empty()) continue;
    tinygltf::Primitive primitive;
    primitive.mode = TINYGLTF_MODE_TRIANGLES;
    primitive.attributes["POSITION"] =
        add_accessor(model, from.positions, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, 3);
    primitive.attributes["NORMAL"] =
        add_accessor(model, from.normals, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, 3);
    primitive.indices = add_accessor(model, from.indices, TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT,
                                     TINYGLTF_TYPE_SCALAR, 1);
    primitive.material = static_cast<int>(model.materials.size());
    tinygltf::Material material;
    const PaintLook& look = kPaints[paint];
    material.name = look.name;
    material.pbrMetallicRoughness.baseColorFactor = {look.color[0], look.color[1], look.color[2],
                                                     1.0};
    material.pbrMetallicRoughness.metallicFactor = look.metallic;
    material.pbrMetallicRoughness.roughnessFactor = look.roughness;
    model.materials.push_back(material);
    mesh.primitives.push_back(primitive);
    triangles += from.indices.size() / 3;
  }
  model.meshes.push_back(mesh);
  tinygltf::Node node;
  node.name = name;
  node.mesh = 0;
  model.nodes.push_back(node);
  tinygltf::Scene scene;
  scene.nodes = {0};
  model.scenes.push_back(scene);
  model.defaultScene = 0;
  if (!tinygltf::TinyGLTF().WriteGltfSceneToFile(&model, file, true, true, false, true)) {
    std::fprintf(stderr, "%s: can't be written; check that the folder exists\n", file.c_str());
    return false;
  }
  std::printf("%s: %zu triangles\n", file.c_str(), triangles);
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: make_models FOLDER\n");
    return 2;
  }
  const std::string folder = std::string(argv[1]) + "/";
  const bool written =
      write(folder + "helicopter.glb", "helicopter", helicopter()) &&
      write(folder + "helicopter_rotor.glb", "helicopter_rotor", main_rotor()) &&
      write(folder + "helicopter_tail_rotor.glb", "helicopter_tail_rotor", tail_rotor());
  return written ? 0 : 1;
}
