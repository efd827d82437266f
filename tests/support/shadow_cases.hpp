// Meshes and cases of the shadow test vectors (shared data), and masks for comparing layers.
#pragma once

#include <gtest/gtest.h>
#include <zlib.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "render/shadow/casters/caster.hpp"
#include "support/json_file.hpp"
#include "support/paths.hpp"

namespace penumbra::test {

// Returns a model of one mesh; source_vertex[i] is i.
inline Model model_of(const std::vector<float>& xyz, const std::vector<std::uint32_t>& indices) {
  Model model;
  Mesh mesh;
  for (std::size_t i = 0; i + 2 < xyz.size(); i += 3) {
    mesh.positions.emplace_back(xyz[i], xyz[i + 1], xyz[i + 2]);
    mesh.source_vertex.push_back(static_cast<std::uint32_t>(i / 3));
  }
  mesh.indices = indices;
  model.source_vertex_count = static_cast<std::uint32_t>(mesh.positions.size());
  model.meshes.push_back(std::move(mesh));
  return model;
}

struct VectorMesh {
  nlohmann::json json;
  ShadowMesh mesh;

  explicit VectorMesh(const std::filesystem::path& file)
      : json(read_json(file)),
        mesh(make_shadow_mesh(model_of(json.at("vertices").get<std::vector<float>>(),
                                       json.at("triangles").get<std::vector<std::uint32_t>>()))) {}

  // Kernels given with the mesh, one per vertex of the file.
  [[nodiscard]] std::vector<Eigen::Vector3d> given_kernels(const std::string& name) const {
    const auto xyz = json.at("kernels").at(name).get<std::vector<double>>();
    std::vector<Eigen::Vector3d> kernels;
    for (std::size_t i = 0; i + 2 < xyz.size(); i += 3)
      kernels.emplace_back(xyz[i], xyz[i + 1], xyz[i + 2]);
    return kernels;
  }
};

inline Eigen::Matrix3d matrix_from(const nlohmann::json& nine) {
  Eigen::Matrix3d m;
  for (int i = 0; i < 9; ++i) m(i / 3, i % 3) = nine.at(static_cast<std::size_t>(i)).get<double>();
  return m;
}
inline Eigen::Vector3d vector_from(const nlohmann::json& three) {
  return {three.at(0).get<double>(), three.at(1).get<double>(), three.at(2).get<double>()};
}

inline Eigen::Vector2d point_from(const nlohmann::json& pair) {
  return {pair.at(0).get<double>(), pair.at(1).get<double>()};
}

using Ring = std::vector<Eigen::Vector2d>;  // closed, plane coordinates [m]

// Returns the rings of polygons {"outer": [[u, v], ...], "holes": [...]}, the format of the test
// vectors and of the program.
inline std::vector<Ring> rings_from(const nlohmann::json& polygons) {
  std::vector<Ring> rings;
  const auto add = [&rings](const nlohmann::json& points) {
    Ring& ring = rings.emplace_back();
    for (const auto& p : points) ring.push_back(point_from(p));
  };
  for (const auto& polygon : polygons) {
    add(polygon.at("outer"));
    for (const auto& hole : polygon.at("holes")) add(hole);
  }
  return rings;
}

inline double distance_to_segment(const Eigen::Vector2d& p, const Eigen::Vector2d& a,
                                  const Eigen::Vector2d& b) {
  const Eigen::Vector2d d = b - a;
  const double t = std::clamp((p - a).dot(d) / std::max(d.squaredNorm(), 1e-300), 0.0, 1.0);
  return (p - a - t * d).norm();
}
inline double distance_to_rings(const Eigen::Vector2d& p, const std::vector<Ring>& rings) {
  double distance = std::numeric_limits<double>::infinity();
  for (const Ring& ring : rings)
    for (std::size_t i = 0; i < ring.size(); ++i)
      distance = std::min(distance, distance_to_segment(p, ring[i], ring[(i + 1) % ring.size()]));
  return distance;
}

// The light height "H" may be the string "inf", because JSON has no infinity.
inline LayeredConstants constants_from(const nlohmann::json& json) {
  const bool zenith = json.at("H").is_string();
  LayeredConstants constants =
      make_layered_constants(
          zenith ? std::numeric_limits<double>::infinity() : json.at("H").get<double>(),
          zenith ? 0.0 : json.at("a").get<double>(),
          zenith ? json.at("h_umbra").get<double>() : 0.0)
          .value();
  if (json.contains("mag_cap")) constants.magnification_cap = json.at("mag_cap").get<double>();
  return constants;
}

// Square bitmap in plane coordinates. A pixel is set if its centre is covered. Row 0 has the lowest
// v.
struct Mask {
  Eigen::Vector2d origin;  // corner of pixel (0, 0)
  double pixel = 0.0;      // [m]
  int size = 0;
  std::vector<std::uint8_t> bits;

  Mask(const Eigen::Vector2d& corner, double pixel_m, int pixels)
      : origin(corner),
        pixel(pixel_m),
        size(pixels),
        bits(static_cast<std::size_t>(pixels) * static_cast<std::size_t>(pixels), 0) {}

  [[nodiscard]] double area() const {
    double count = 0.0;
    for (const std::uint8_t bit : bits) count += bit;
    return count * pixel * pixel;
  }

  void cover_triangle(const std::array<Eigen::Vector2d, 3>& corners) {
    std::array<Eigen::Vector2d, 3> p;
    for (std::size_t i = 0; i < 3; ++i) p[i] = (corners[i] - origin) / pixel;
    cover_rings({{p[0], p[1], p[2]}});
  }
  void cover(const std::vector<PlanePoint>& triangles) {
    for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
      std::array<Eigen::Vector2d, 3> corners;
      for (std::size_t j = 0; j < 3; ++j)
        corners[j] = {static_cast<double>(triangles[i + j].u),
                      static_cast<double>(triangles[i + j].v)};
      cover_triangle(corners);
    }
  }
  // Uses the even-odd rule.
  void cover(const std::vector<Ring>& rings) {
    std::vector<Ring> in_pixels = rings;
    for (Ring& ring : in_pixels)
      for (Eigen::Vector2d& p : ring) p = (p - origin) / pixel;
    cover_rings(in_pixels);
  }
  // Like cover(), for rings in pixel coordinates.
  void cover_rings(const std::vector<Ring>& rings) {
    double low = size;
    double high = 0.0;
    for (const auto& ring : rings) {
      for (const auto& p : ring) {
        low = std::min(low, p.y());
        high = std::max(high, p.y());
      }
    }
    std::vector<double> crossings;
    const int first = std::max(0, static_cast<int>(std::ceil(low - 0.5)));
    const int last = std::min(size - 1, static_cast<int>(std::floor(high - 0.5)));
    for (int row = first; row <= last; ++row) {
      const double y = row + 0.5;
      crossings.clear();
      for (const auto& ring : rings) {
        for (std::size_t i = 0; i < ring.size(); ++i) {
          const Eigen::Vector2d& a = ring[i];
          const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
          if ((a.y() <= y) == (b.y() <= y)) continue;
          crossings.push_back(a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x()));
        }
      }
      std::sort(crossings.begin(), crossings.end());
      for (std::size_t i = 0; i + 1 < crossings.size(); i += 2) {
        const int from = std::max(0, static_cast<int>(std::ceil(crossings[i] - 0.5)));
        const int to = std::min(size - 1, static_cast<int>(std::floor(crossings[i + 1] - 0.5)));
        for (int column = from; column <= to; ++column) bits[index(column, row)] = 1;
      }
    }
  }
  [[nodiscard]] std::size_t index(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(size) +
           static_cast<std::size_t>(column);
  }
};

// Intersection over union; 1 if both are empty.
inline double iou(const std::vector<std::uint8_t>& a, const std::vector<std::uint8_t>& b) {
  std::size_t both = 0;
  std::size_t either = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    both += (a[i] != 0 && b[i] != 0) ? 1U : 0U;
    either += (a[i] != 0 || b[i] != 0) ? 1U : 0U;
  }
  return either == 0 ? 1.0 : static_cast<double>(both) / static_cast<double>(either);
}

// Decodes a mask: base64 of zlib-compressed, packed bits, most significant bit first.
inline std::vector<std::uint8_t> decode_mask(const std::string& text, std::size_t bit_count) {
  std::vector<std::uint8_t> packed;
  std::uint32_t buffer = 0;
  int pending_bits = 0;
  for (const char c : text) {
    int value = -1;
    if (c >= 'A' && c <= 'Z') value = c - 'A';
    if (c >= 'a' && c <= 'z') value = c - 'a' + 26;
    if (c >= '0' && c <= '9') value = c - '0' + 52;
    if (c == '+') value = 62;
    if (c == '/') value = 63;
    if (value < 0) continue;
    buffer = (buffer << 6U) | static_cast<std::uint32_t>(value);
    pending_bits += 6;
    if (pending_bits >= 8) {
      pending_bits -= 8;
      packed.push_back(
          static_cast<std::uint8_t>((buffer >> static_cast<unsigned>(pending_bits)) & 0xffU));
    }
  }
  std::vector<std::uint8_t> bytes((bit_count + 7) / 8);
  uLongf length = bytes.size();
  EXPECT_EQ(uncompress(bytes.data(), &length, packed.data(), packed.size()), Z_OK);
  EXPECT_EQ(length, bytes.size());
  std::vector<std::uint8_t> bits(bit_count);
  for (std::size_t i = 0; i < bit_count; ++i)
    bits[i] = static_cast<std::uint8_t>((bytes[i / 8] >> (7U - i % 8U)) & 1U);
  return bits;
}

}  // namespace penumbra::test
