#include "render/shadow/layers/layered_penumbra.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace penumbra {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

bool positive_and_finite(double value) {
  return std::isfinite(value) && value > 0.0;
}

// Shaders divide by H and h_u and multiply by a, in floats: neither these nor their inverses may
// leave a float's range.
bool fits_float(double value) {
  return value >= 1e-30 && value <= 1e30;
}

// The least float >= value. A clip height rounded up makes `h >= clip` for a float h the same
// statement as for the exact clip height: one predicate for clipping and for factors.
float rounded_up(double value) {
  const auto nearest = static_cast<float>(value);
  return static_cast<double>(nearest) < value
             ? std::nextafter(nearest, std::numeric_limits<float>::infinity())
             : nearest;
}

bool umbra_vanishes(const LayeredConstants& constants) {
  return constants.light_ratio > 1.0 || std::isinf(constants.light_height);
}

bool is_finite(const CasterVertex& vertex) {
  return std::isfinite(vertex.u) && std::isfinite(vertex.v) && std::isfinite(vertex.h) &&
         std::isfinite(vertex.ku) && std::isfinite(vertex.kv);
}

// Where the edge between the two vertices meets a height that lies between theirs. Always computed
// from the lower vertex, so that the two faces of an edge get the same point.
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

// s - 1 of the middle and penumbra layers, which float keeps to full accuracy next to contact.
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

// One Sutherland-Hodgman step; `above` keeps h >= height, otherwise h <= height.
ClippedFace clip_face(const ClippedFace& face, float height, bool above) {
  ClippedFace clipped;
  for (std::size_t i = 0; i < face.count; ++i) {
    const CasterVertex& from = face.vertices[i];
    const CasterVertex& to = face.vertices[(i + 1) % face.count];
    const bool from_in = above ? from.h >= height : from.h <= height;
    const bool to_in = above ? to.h >= height : to.h <= height;
    if (from_in) clipped.add(from);
    // A vertex on the clip height is its own cut.
    if (from_in != to_in && from.h != height && to.h != height) {
      clipped.add(at_height(from, to, height));
    }
  }
  return clipped;
}

}  // namespace

Result<LayeredConstants> make_layered_constants(double light_height, double light_ratio,
                                                double umbra_height) {
  if (std::isnan(light_height) || light_height <= 0.0) {
    return fail("light height H: is {}; give metres above 0, or inf with an umbra height",
                light_height);
  }
  if (!std::isinf(light_height) && !fits_float(light_height)) {
    return fail("light height H: is {}; give metres from 1e-30 to 1e30", light_height);
  }
  if (std::isnan(light_ratio) || light_ratio < 0.0) {
    return fail("light ratio a: is {}; give a number above 0 (2 to 5 is usual)", light_ratio);
  }
  if (!std::isfinite(umbra_height) || umbra_height < 0.0) {
    return fail("umbra height h_u: is {}; give metres above 0", umbra_height);
  }
  if (umbra_height > 0.0 && !fits_float(umbra_height)) {
    return fail("umbra height h_u: is {}; give metres from 1e-30 to 1e30", umbra_height);
  }
  if (light_ratio > 0.0 && !std::isinf(light_ratio) && !fits_float(light_ratio)) {
    return fail("light ratio a: is {}; give a number from 1e-30 to 1e30", light_ratio);
  }
  LayeredConstants constants;
  constants.light_height = light_height;
  if (std::isinf(light_height)) {
    // The zenith limit: the light's radius grows with its height, so that only h_u = H / a is left.
    if (umbra_height <= 0.0) {
      return fail("umbra height h_u: is missing; a light at infinity needs it");
    }
    if (light_ratio > 0.0 && !std::isinf(light_ratio)) {
      return fail("light ratio a: is {} with H = inf; leave it out and give the umbra height",
                  light_ratio);
    }
    constants.light_ratio = kInfinity;
    constants.umbra_height = umbra_height;
    return constants;
  }
  if (std::isinf(light_ratio)) {
    return fail("light ratio a: is {}; give a number above 0 (2 to 5 is usual)", light_ratio);
  }
  if (light_ratio <= 0.0 && umbra_height <= 0.0) {
    return fail("light ratio a: is missing, and so is the umbra height h_u; give one of the two");
  }
  constants.light_ratio = light_ratio > 0.0 ? light_ratio : light_height / umbra_height;
  constants.umbra_height = light_height / constants.light_ratio;
  if (!fits_float(constants.light_ratio) || !fits_float(constants.umbra_height)) {
    return light_ratio > 0.0 ? fail("light ratio a: is {}, too far from the light height {}",
                                    light_ratio, light_height)
                             : fail("umbra height h_u: is {}, too far from the light height {}",
                                    umbra_height, light_height);
  }
  if (umbra_height > 0.0 &&
      std::abs(umbra_height - constants.umbra_height) > 1e-6 * constants.umbra_height) {
    return fail("umbra height h_u: is {} but H / a is {}; give either a or h_u", umbra_height,
                constants.umbra_height);
  }
  return constants;
}

Result<LayeredConstants> layered_constants_for_workspace(double max_height, double magnification) {
  if (!positive_and_finite(max_height)) {
    return fail("workspace height: is {}; give metres above 0", max_height);
  }
  if (!std::isfinite(magnification) || magnification <= 1.0) {
    return fail("magnification: is {}; give a number above 1", magnification);
  }
  // shadows.md 2.4: a = M / (M - 1), H = a h_max, so that h_u = h_max.
  const double ratio = magnification / (magnification - 1.0);
  return make_layered_constants(ratio * max_height, ratio, 0.0);
}

HeightRange layer_height_range(const LayeredConstants& constants, ShadowLayer layer) {
  HeightRange range;
  range.high = std::isinf(constants.light_height)
                   ? kInfinity
                   : constants.light_height * (1.0 - 1.0 / constants.magnification_cap);
  if (layer == ShadowLayer::umbra && umbra_vanishes(constants)) {
    range.high = std::min(range.high, constants.umbra_height);
  }
  return range;
}

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
  const double left = constants.light_height - std::clamp(h, range.low, range.high);
  return (1.0 + lambda * constants.light_ratio) * constants.light_height / (left * left);
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
  // The product of two floats is exact in double. Next to h_u, where the terms cancel, this keeps
  // what 1 - (a - 1) t would lose (3e-8).
  const double left =
      static_cast<double>(light) - static_cast<double>(ratio) * static_cast<double>(height);
  return std::max(0.0F, static_cast<float>(left) / (light - height));
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
    if (indices[i] >= vertices.size() || indices[i + 1] >= vertices.size() ||
        indices[i + 2] >= vertices.size()) {
      continue;
    }
    const CasterVertex& a = vertices[indices[i]];
    const CasterVertex& b = vertices[indices[i + 1]];
    const CasterVertex& c = vertices[indices[i + 2]];
    if (!is_finite(a) || !is_finite(b) || !is_finite(c)) continue;
    const float lowest = std::min({a.h, b.h, c.h});
    const float highest = std::max({a.h, b.h, c.h});
    // A face that lies in the plane is in contact and casts; one at the upper limit has vanished.
    if (highest < low || lowest >= high) continue;
    if (lowest >= low && highest <= high) {
      triangles.insert(triangles.end(), {a, b, c});
      continue;
    }
    ClippedFace face;
    face.add(a);
    face.add(b);
    face.add(c);
    if (lowest < low) face = clip_face(face, low, true);
    if (highest > high) face = clip_face(face, high, false);
    for (std::size_t corner = 2; corner < face.count; ++corner) {
      triangles.insert(triangles.end(),
                       {face.vertices[0], face.vertices[corner - 1], face.vertices[corner]});
    }
  }
  return triangles;
}

PlanePoint project_to_layer(const CasterVertex& vertex, const LayeredConstants& constants,
                            ShadowLayer layer) {
  const float du = vertex.u - vertex.ku;
  const float dv = vertex.v - vertex.kv;
  if (layer == ShadowLayer::umbra) {
    // From k: the umbra collapses onto the kernel exactly.
    const float s = layer_factor_f(constants, layer, vertex.h);
    return {vertex.ku + s * du, vertex.kv + s * dv};
  }
  // From x: at contact the imaginary vertex is the vertex exactly.
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
  for (const CasterVertex& vertex : clipped) {
    triangles.push_back(project_to_layer(vertex, constants, layer));
  }
  return triangles;
}

std::vector<PlanePoint> orthogonal_triangles(std::span<const CasterVertex> vertices,
                                             std::span<const std::uint32_t> indices) {
  std::vector<PlanePoint> triangles;
  for (const CasterVertex& vertex : clip_to_heights(vertices, indices, {0.0, kInfinity})) {
    triangles.push_back({vertex.u, vertex.v});
  }
  return triangles;
}

}  // namespace penumbra
