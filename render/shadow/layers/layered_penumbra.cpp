#include "render/shadow/layers/layered_penumbra.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace penumbra {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Returns the smallest float >= value. A clip height rounded up accepts the same floats h by `h >=
// clip` as the exact height.
float rounded_up(double value) {
  const auto nearest = static_cast<float>(value);
  return static_cast<double>(nearest) < value
             ? std::nextafter(nearest, std::numeric_limits<float>::infinity())
             : nearest;
}

bool is_finite(const CasterVertex& vertex) {
  return std::isfinite(vertex.u) && std::isfinite(vertex.v) && std::isfinite(vertex.h) &&
         std::isfinite(vertex.ku) && std::isfinite(vertex.kv);
}

// Returns the point of an edge at a height between its ends. Interpolates from the lower vertex, so
// that both faces at an edge get the same point.
CasterVertex at_height(const CasterVertex& a, const CasterVertex& b, float height) {
  const CasterVertex& low = a.h <= b.h ? a : b;
  const CasterVertex& high = a.h <= b.h ? b : a;
  const double t = (static_cast<double>(height) - static_cast<double>(low.h)) /
                   (static_cast<double>(high.h) - static_cast<double>(low.h));
  const auto mix = [t](float from, float to) {
    return static_cast<float>(static_cast<double>(from) +
                              t * (static_cast<double>(to) - static_cast<double>(from)));
  };
  return {mix(low.u, high.u), mix(low.v, high.v), height, mix(low.ku, high.ku),
          mix(low.kv, high.kv)};
}

// Returns s - 1 of the middle or penumbra layer, with full relative accuracy near contact.
float layer_growth_f(const LayeredConstants& constants, ShadowLayer layer, float h) {
  const float high = rounded_up(layer_height_range(constants, layer).high);
  const float height = std::clamp(h, 0.0F, high);
  if (std::isinf(constants.light_height)) {
    return layer == ShadowLayer::middle ? 0.0F
                                        : height / static_cast<float>(constants.umbra_height);
  }
  const float t = height / (static_cast<float>(constants.light_height) - height);
  return layer == ShadowLayer::middle ? t : (1.0F + static_cast<float>(constants.light_ratio)) * t;
}

struct ClippedFace {
  std::array<CasterVertex, 6> vertices;
  std::size_t count = 0;
  void add(const CasterVertex& vertex) { vertices[count++] = vertex; }
};

// Does one step of Sutherland-Hodgman clipping to h >= height if `above`, else to h <= height.
ClippedFace clip_face(const ClippedFace& face, float height, bool above) {
  ClippedFace clipped;
  for (std::size_t i = 0; i < face.count; ++i) {
    const CasterVertex& from = face.vertices[i];
    const CasterVertex& to = face.vertices[(i + 1) % face.count];
    const bool from_in = above ? from.h >= height : from.h <= height;
    const bool to_in = above ? to.h >= height : to.h <= height;
    if (from_in) clipped.add(from);
    // A vertex at the clip height needs no new vertex.
    if (from_in != to_in && from.h != height && to.h != height) {
      clipped.add(at_height(from, to, height));
    }
  }
  return clipped;
}

}  // namespace

double layer_factor(const LayeredConstants& constants, ShadowLayer layer, double h) {
  const double height = std::clamp(h, 0.0, layer_height_range(constants, layer).high);
  const double light = constants.light_height;
  if (layer == ShadowLayer::umbra && umbra_vanishes(constants) &&
      height >= constants.umbra_height) {
    return 0.0;
  }
  if (std::isinf(light)) return 1.0 + lambda_of(layer) * height / constants.umbra_height;
  const double ratio = constants.light_ratio;
  if (layer == ShadowLayer::umbra) return std::fma(-ratio, height, light) / (light - height);
  return 1.0 + (1.0 + lambda_of(layer) * ratio) * height / (light - height);
}

double layer_rate(const LayeredConstants& constants, ShadowLayer layer, double h) {
  const HeightRange range = layer_height_range(constants, layer);
  const double lambda = lambda_of(layer);
  if (std::isinf(constants.light_height)) return lambda / constants.umbra_height;
  const double depth = constants.light_height - std::clamp(h, range.low, range.high);
  return (1.0 + lambda * constants.light_ratio) * constants.light_height / (depth * depth);
}

float layer_factor_f(const LayeredConstants& constants, ShadowLayer layer, float h) {
  const float high = rounded_up(layer_height_range(constants, layer).high);
  const float height = std::clamp(h, 0.0F, high);
  if (layer == ShadowLayer::umbra && umbra_vanishes(constants) &&
      height >= rounded_up(constants.umbra_height)) {
    return 0.0F;
  }
  if (layer != ShadowLayer::umbra) return 1.0F + layer_growth_f(constants, layer, height);
  if (std::isinf(constants.light_height)) {
    return std::max(0.0F, 1.0F - height / static_cast<float>(constants.umbra_height));
  }
  const auto light = static_cast<float>(constants.light_height);
  const auto ratio = static_cast<float>(constants.light_ratio);
  // The product is exact in double, which matters near h_u, where the terms cancel.
  const double numerator =
      static_cast<double>(light) - static_cast<double>(ratio) * static_cast<double>(height);
  return std::max(0.0F, static_cast<float>(numerator) / (light - height));
}

std::vector<CasterVertex> clip_to_heights(std::span<const CasterVertex> vertices,
                                          std::span<const std::uint32_t> indices,
                                          const HeightRange& range) {
  std::vector<CasterVertex> triangles;
  triangles.reserve(indices.size());
  const float low = rounded_up(range.low);
  const float high = rounded_up(range.high);
  if (!(low < high)) return triangles;
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    if (std::ranges::max(indices.subspan(i, 3)) >= vertices.size()) continue;
    const CasterVertex& a = vertices[indices[i]];
    const CasterVertex& b = vertices[indices[i + 1]];
    const CasterVertex& c = vertices[indices[i + 2]];
    if (!is_finite(a) || !is_finite(b) || !is_finite(c)) continue;
    const float lowest = std::min({a.h, b.h, c.h});
    const float highest = std::max({a.h, b.h, c.h});
    // A face in the plane casts a shadow; a face at the upper limit does not.
    if (highest < low || lowest >= high) continue;
    if (lowest >= low && highest <= high) {
      triangles.insert(triangles.end(), {a, b, c});
      continue;
    }
    ClippedFace face{{a, b, c}, 3};
    if (lowest < low) face = clip_face(face, low, true);
    if (highest > high) face = clip_face(face, high, false);
    const std::array<CasterVertex, 6>& v = face.vertices;
    for (std::size_t corner = 2; corner < face.count; ++corner)
      triangles.insert(triangles.end(), {v[0], v[corner - 1], v[corner]});
  }
  return triangles;
}

PlanePoint project_to_layer(const CasterVertex& vertex, const LayeredConstants& constants,
                            ShadowLayer layer) {
  const float du = vertex.u - vertex.ku;
  const float dv = vertex.v - vertex.kv;
  if (layer == ShadowLayer::umbra) {
    // Computed from k, so that the umbra shrinks exactly to the kernel.
    const float s = layer_factor_f(constants, layer, vertex.h);
    return {vertex.ku + s * du, vertex.kv + s * dv};
  }
  // Computed from x, so that the projected vertex is exactly the vertex at contact.
  const float growth = layer_growth_f(constants, layer, vertex.h);
  return {vertex.u + growth * du, vertex.v + growth * dv};
}

std::vector<PlanePoint> layer_triangles(std::span<const CasterVertex> vertices,
                                        std::span<const std::uint32_t> indices,
                                        const LayeredConstants& constants, ShadowLayer layer) {
  const std::vector<CasterVertex> clipped =
      clip_to_heights(vertices, indices, layer_height_range(constants, layer));
  std::vector<PlanePoint> triangles;
  triangles.reserve(clipped.size());
  for (const CasterVertex& vertex : clipped)
    triangles.push_back(project_to_layer(vertex, constants, layer));
  return triangles;
}

std::vector<PlanePoint> orthogonal_triangles(std::span<const CasterVertex> vertices,
                                             std::span<const std::uint32_t> indices) {
  std::vector<PlanePoint> triangles;
  for (const CasterVertex& vertex : clip_to_heights(vertices, indices, {0.0, kInfinity}))
    triangles.push_back({vertex.u, vertex.v});
  return triangles;
}

}  // namespace penumbra
