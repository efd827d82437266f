#include "render/shadow/layers/layer_update.hpp"

#include <algorithm>
#include <cmath>

#include "core/vector_clones.hpp"

namespace penumbra {

namespace {

struct Rows {
  float u[4], v[4], h[4];  // plane coordinates: row . (x, y, z, 1)
};

struct Factors {
  float light;        // H; 1 for a light at infinity
  float minus_slope;  // what of h is taken from H in the denominator: 1, or 0 at infinity
  float umbra_slope;  // umbra: (H - umbra_slope h) / denominator
  float penumbra;     // (s_p - 1) / t with t = h / denominator: 1 + a, or 1 / h_u
  float middle;       // the same of the middle layer: 1, or 0
  float high;         // cap of every layer
  float umbra_high;   // heights from here on have no umbra
};

struct Pointers {
  const float *x, *y, *z, *kx, *ky, *kz;
  float *h, *umbra_u, *umbra_v, *middle_u, *middle_v, *penumbra_u, *penumbra_v;
};

PENUMBRA_VECTOR_CLONES
void project(const Pointers& p, std::size_t count, const Rows& given_rows,
             const Factors& given_factors) {
  // Copies and: nothing that is written can change them, so they stay in registers.
  const Rows rows = given_rows;
  const Factors f = given_factors;
  const float* x = p.x;
  const float* y = p.y;
  const float* z = p.z;
  const float* kx = p.kx;
  const float* ky = p.ky;
  const float* kz = p.kz;
  float* h_out = p.h;
  float* umbra_u = p.umbra_u;
  float* umbra_v = p.umbra_v;
  float* middle_u = p.middle_u;
  float* middle_v = p.middle_v;
  float* penumbra_u = p.penumbra_u;
  float* penumbra_v = p.penumbra_v;
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // the arrays are thirteen different ones
#endif
  for (std::size_t i = 0; i < count; ++i) {
    const float u = rows.u[0] * x[i] + rows.u[1] * y[i] + rows.u[2] * z[i] + rows.u[3];
    const float v = rows.v[0] * x[i] + rows.v[1] * y[i] + rows.v[2] * z[i] + rows.v[3];
    const float h = rows.h[0] * x[i] + rows.h[1] * y[i] + rows.h[2] * z[i] + rows.h[3];
    // Differences of positions, not of projections: exact where vertex and kernel are close.
    const float ox = x[i] - kx[i];
    const float oy = y[i] - ky[i];
    const float oz = z[i] - kz[i];
    const float du = rows.u[0] * ox + rows.u[1] * oy + rows.u[2] * oz;
    const float dv = rows.v[0] * ox + rows.v[1] * oy + rows.v[2] * oz;
    const float zero = 0.0F;
    const float above = h > zero ? h : zero;
    const float height = above < f.high ? above : f.high;
    const float umbra_height = height < f.umbra_high ? height : f.umbra_high;
    const float per_denominator = 1.0F / (f.light - f.minus_slope * height);
    const float t = height * per_denominator;
    const float s = (f.light - f.umbra_slope * umbra_height) * per_denominator;
    const float umbra = height < f.umbra_high ? (s > zero ? s : zero) : zero;
    h_out[i] = h;
    umbra_u[i] = (u - du) + umbra * du;
    umbra_v[i] = (v - dv) + umbra * dv;
    middle_u[i] = u + f.middle * t * du;
    middle_v[i] = v + f.middle * t * dv;
    penumbra_u[i] = u + f.penumbra * t * du;
    penumbra_v[i] = v + f.penumbra * t * dv;
  }
}

Factors factors_of(const LayeredConstants& constants) {
  Factors f{};
  f.high =
      static_cast<float>(std::min(layer_height_range(constants, ShadowLayer::penumbra).high, 1e30));
  const bool vanishes = constants.light_ratio > 1.0;
  f.umbra_high = vanishes ? static_cast<float>(constants.umbra_height) : 1e30F;
  if (std::isinf(constants.light_height)) {
    f.light = 1.0F;
    f.minus_slope = 0.0F;
    f.umbra_slope = static_cast<float>(1.0 / constants.umbra_height);
    f.penumbra = f.umbra_slope;
    f.middle = 0.0F;
  } else {
    f.light = static_cast<float>(constants.light_height);
    f.minus_slope = 1.0F;
    f.umbra_slope = static_cast<float>(constants.light_ratio);
    f.penumbra = static_cast<float>(1.0 + constants.light_ratio);
    f.middle = 1.0F;
  }
  return f;
}

}  // namespace

CasterArrays CasterArrays::make(const ShadowMesh& mesh, const ShadowKernels& kernels) {
  CasterArrays arrays;
  const auto split = [](const std::vector<glm::vec3>& points, std::vector<float>& x,
                        std::vector<float>& y, std::vector<float>& z) {
    for (const glm::vec3& p : points) {
      x.push_back(p.x);
      y.push_back(p.y);
      z.push_back(p.z);
    }
  };
  split(mesh.positions, arrays.x, arrays.y, arrays.z);
  split(kernels.kernels, arrays.kx, arrays.ky, arrays.kz);
  return arrays;
}

void update_layers(const CasterArrays& caster, const Placement& T_world_object,
                   const PlaneFrame& plane, const LayeredConstants& constants,
                   LayerArrays& layers) {
  const std::size_t count = caster.size();
  for (std::size_t layer = 0; layer < 3; ++layer) {
    layers.u[layer].resize(count);
    layers.v[layer].resize(count);
  }
  layers.h.resize(count);
  const PlaneMap map = plane_map(T_world_object, plane);
  Rows rows{};
  for (int column = 0; column < 4; ++column) {
    const auto entry = [&](int row) {
      return static_cast<float>(column < 3 ? map.linear(row, column) : map.offset(row));
    };
    rows.u[column] = entry(0);
    rows.v[column] = entry(1);
    rows.h[column] = entry(2);
  }
  const Pointers pointers = {caster.x.data(),    caster.y.data(),    caster.z.data(),
                             caster.kx.data(),   caster.ky.data(),   caster.kz.data(),
                             layers.h.data(),    layers.u[0].data(), layers.v[0].data(),
                             layers.u[1].data(), layers.v[1].data(), layers.u[2].data(),
                             layers.v[2].data()};
  project(pointers, count, rows, factors_of(constants));
}

}  // namespace penumbra
