// The body of alignment_kernel.hpp, included by one .cpp file per instruction set.
// PENUMBRA_KERNEL names the variant's namespace. Only builtins and plain arrays here.
#include "tracking/alignment_kernel.hpp"

#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace penumbra::kernel::PENUMBRA_KERNEL {
namespace {

#define PENUMBRA_INLINE inline __attribute__((always_inline))

constexpr int kLanes = 16;

// exp(-x) for x >= 0, relative error under 3e-7: 2^-n by the exponent bits, a polynomial for the
// rest. Flushes to about 1e-35.
PENUMBRA_INLINE float exp_negative(float x) {
  const float clamped = x < 80.0F ? x : 80.0F;
  const float scaled = clamped * -1.44269504F;
  // Adding 1.5 * 2^23 rounds to the nearest integer and leaves it in the low bits.
  const float shifted = scaled + 12582912.0F;
  const float n = shifted - 12582912.0F;
  const float f = (scaled - n) * 0.69314718F;  // in [-0.35, 0.35]
  const float p =
      1.0F +
      f * (1.0F + f * (0.5F + f * (0.16666667F +
                                   f * (0.04166667F + f * (0.00833333F + f * 0.00138889F)))));
  int bits = 0;
  __builtin_memcpy(&bits, &shifted, sizeof bits);
  const int exponent = (bits - 0x4B400000 + 127) << 23;
  float scale = 0.0F;
  __builtin_memcpy(&scale, &exponent, sizeof scale);
  return p * scale;
}

// Normal distribution and its density: Abramowitz and Stegun 7.1.25, error under 1.3e-5.
PENUMBRA_INLINE float normal_cdf(float u, float& density) {
  const float t = __builtin_fabsf(u) * 0.70710678F;
  const float e = exp_negative(t * t);
  const float q = 1.0F / (1.0F + 0.47047F * t);
  const float tail = 0.5F * e * q * (0.3480242F + q * (-0.0958798F + q * 0.7478556F));
  density = 0.39894228F * e;
  return u >= 0.0F ? 1.0F - tail : tail;
}

// Bivariate normal distribution: product plus an integral over the correlation (Plackett), with
// r = sin(theta), by three Gauss-Legendre nodes. d_x, d_y: derivatives.
PENUMBRA_INLINE float binormal_cdf(float x, float y, float rho, float cdf_x, float cdf_y,
                                   float density_x, float density_y, float& d_x, float& d_y) {
  constexpr float kNode[3] = {0.11270167F, 0.5F, 0.88729833F};
  constexpr float kWeight[3] = {0.27777778F, 0.44444444F, 0.27777778F};
  // asin for |rho| <= 0.95: Abramowitz and Stegun 4.4.45, error under 7e-5.
  const float r = __builtin_fabsf(rho);
  const float arc = 1.5707288F + r * (-0.2121144F + r * (0.0742610F - r * 0.0187293F));
  const float angle_abs = 1.5707963F - __builtin_sqrtf(1.0F - r) * arc;
  const float angle = rho < 0.0F ? -angle_abs : angle_abs;
  const float squares = 0.5F * (x * x + y * y);
  const float product = x * y;
  float integral = 0.0F;
#pragma GCC unroll 3
  for (int k = 0; k < 3; ++k) {
    const float theta = angle * kNode[k];
    const float t2 = theta * theta;
    // sin by its series; |theta| < 1.26
    const float s =
        theta *
        (1.0F + t2 * (-0.16666667F + t2 * (0.00833333F + t2 * (-0.00019841F + t2 * 2.7557e-6F))));
    const float inverse = 1.0F / (1.0F - s * s);
    const float z = (squares - product * s) * inverse;
    integral += kWeight[k] * exp_negative(z > 0.0F ? z : 0.0F);
  }
  const float root = 1.0F / __builtin_sqrtf(1.0F - rho * rho);
  float unused = 0.0F;
  d_x = density_x * normal_cdf((y - rho * x) * root, unused);
  d_y = density_y * normal_cdf((x - rho * y) * root, unused);
  return cdf_x * cdf_y + angle * 0.15915494F * integral;
}

PENUMBRA_INLINE float arc_tangent(float r) {  // of r >= 0; Abramowitz and Stegun 4.4.49
  const bool large = r > 1.0F;
  const float x = large ? 1.0F / r : r;
  const float z = x * x;
  float p = 0.0028662257F;
  p = p * z - 0.0161657367F;
  p = p * z + 0.0429096138F;
  p = p * z - 0.0752896400F;
  p = p * z + 0.1065626393F;
  p = p * z - 0.1420889944F;
  p = p * z + 0.1999355085F;
  p = p * z - 0.3333314528F;
  p = x + x * z * p;
  return large ? 1.57079633F - p : p;
}

// Distorted coordinates and their derivative (see core/camera_model.hpp).
template <Lens::Kind kind>
PENUMBRA_INLINE void distort(const Lens& lens, float x, float y, float& xd, float& yd, float& j00,
                             float& j01, float& j11) {
  const float r2 = x * x + y * y;
  const float* k = lens.k;
  if constexpr (kind == Lens::Kind::none) {
    xd = x;
    yd = y;
    j00 = 1.0F;
    j01 = 0.0F;
    j11 = 1.0F;
  } else if constexpr (kind != Lens::Kind::fisheye) {
    float radial = 1.0F + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    float d_radial = k[0] + r2 * (2.0F * k[1] + r2 * 3.0F * k[4]);
    if constexpr (kind == Lens::Kind::rational) {
      const float inverse = 1.0F / (1.0F + r2 * (k[5] + r2 * (k[6] + r2 * k[7])));
      const float d_denominator = k[5] + r2 * (2.0F * k[6] + r2 * 3.0F * k[7]);
      radial *= inverse;
      d_radial = (d_radial - radial * d_denominator) * inverse;
    }
    const float xy2 = 2.0F * x * y;
    xd = x * radial + k[2] * xy2 + k[3] * (r2 + 2.0F * x * x);
    yd = y * radial + k[2] * (r2 + 2.0F * y * y) + k[3] * xy2;
    j00 = radial + 2.0F * x * x * d_radial + 2.0F * k[2] * y + 6.0F * k[3] * x;
    j01 = xy2 * d_radial + 2.0F * (k[2] * x + k[3] * y);
    j11 = radial + 2.0F * y * y * d_radial + 6.0F * k[2] * y + 2.0F * k[3] * x;
  } else {
    const float r2_safe = r2 > 1e-8F ? r2 : 1e-8F;
    const float r = __builtin_sqrtf(r2_safe);
    const float t = arc_tangent(r);
    const float t2 = t * t;
    const float theta_d = t * (1.0F + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    const float d_theta_d =
        1.0F + t2 * (3.0F * k[0] + t2 * (5.0F * k[1] + t2 * (7.0F * k[2] + t2 * 9.0F * k[3])));
    const float scale = theta_d / r;
    const float d_scale = (d_theta_d / (1.0F + r2_safe) - scale) / r2_safe;
    xd = scale * x;
    yd = scale * y;
    j00 = scale + d_scale * x * x;
    j01 = d_scale * x * y;
    j11 = scale + d_scale * y * y;
  }
}

template <Lens::Kind kind>
void project_as(const Lens& lens, const Blur& blur, const float* M, const float* N,
                const Vertices& v) {
  const float inverse_fx = 1.0F / lens.fx;
  const float inverse_fy = 1.0F / lens.fy;
  const float mxx = blur.motion_x_px * blur.motion_x_px * (1.0F / 12.0F);
  const float mxy = blur.motion_x_px * blur.motion_y_px * (1.0F / 12.0F);
  const float myy = blur.motion_y_px * blur.motion_y_px * (1.0F / 12.0F);
  const float cxx = blur.variance_px2 + mxx;
  const float cyy = blur.variance_px2 + myy;
#pragma omp simd
  for (int i = 0; i < v.count; ++i) {
    const float a = v.a[i];
    const float b = v.b[i];
    const float X = M[0] * a + M[1] * b + M[2];
    const float Y = M[3] * a + M[4] * b + M[5];
    const float Z = M[6] * a + M[7] * b + M[8];
    const float inverse = 1.0F / (Z > 1e-9F ? Z : 1e-9F);
    const float x = X * inverse;
    const float y = Y * inverse;
    float xd = 0.0F;
    float yd = 0.0F;
    float j00 = 0.0F;
    float j01 = 0.0F;
    float j11 = 0.0F;
    distort<kind>(lens, x, y, xd, yd, j00, j01, j11);
    v.ray_x[i] = x;
    v.ray_y[i] = y;
    v.pixel_x[i] = lens.fx * xd + lens.cx;
    v.pixel_y[i] = lens.fy * yd + lens.cy;
    v.depth[i] = Z;
    const float inverse_det = 1.0F / (j00 * j11 - j01 * j01);
    const float i00 = j11 * inverse_det;
    const float i01 = -j01 * inverse_det;
    const float i11 = j00 * inverse_det;
    // d(a, b) / d ray, then by the pixel
    const float inverse_s = 1.0F / (N[6] * x + N[7] * y + N[8]);
    const float ax = (N[0] - a * N[6]) * inverse_s;
    const float ay = (N[1] - a * N[7]) * inverse_s;
    const float bx = (N[3] - b * N[6]) * inverse_s;
    const float by = (N[4] - b * N[7]) * inverse_s;
    const float au = (ax * i00 + ay * i01) * inverse_fx;
    const float av = (ax * i01 + ay * i11) * inverse_fy;
    const float bu = (bx * i00 + by * i01) * inverse_fx;
    const float bv = (bx * i01 + by * i11) * inverse_fy;
    const float var_a = au * au * cxx + 2.0F * au * av * mxy + av * av * cyy;
    const float var_b = bu * bu * cxx + 2.0F * bu * bv * mxy + bv * bv * cyy;
    const float cov = au * bu * cxx + (au * bv + av * bu) * mxy + av * bv * cyy;
    const float ka = 1.0F / __builtin_sqrtf(var_a);
    const float kb = 1.0F / __builtin_sqrtf(var_b);
    const float rho = cov * ka * kb;
    v.ka[i] = ka;
    v.kb[i] = kb;
    v.rho[i] = rho > 0.95F ? 0.95F : rho < -0.95F ? -0.95F : rho;
  }
}

template <Lens::Kind kind>
void prepare_as(const Lens& lens, const float* M, int reach, int side, const Samples& s) {
  const auto last = static_cast<float>(side - 1);
  const float anchor_shift = reach == 2 ? 0.5F : 0.0F;
  const float inverse_fx = 1.0F / lens.fx;
  const float inverse_fy = 1.0F / lens.fy;
#pragma omp simd
  for (int i = 0; i < s.count; ++i) {
    const float target_x = (s.pixel_x[i] - lens.cx) * inverse_fx;
    const float target_y = (s.pixel_y[i] - lens.cy) * inverse_fy;
    float x = target_x;
    float y = target_y;
    if constexpr (kind != Lens::Kind::none) {
      // Newton from a guess a few pixels off; the second step, with the first one's derivative,
      // brings it to float precision.
      float xd = 0.0F;
      float yd = 0.0F;
      float j00 = 0.0F;
      float j01 = 0.0F;
      float j11 = 0.0F;
      x = s.ray_x[i];
      y = s.ray_y[i];
      distort<kind>(lens, x, y, xd, yd, j00, j01, j11);
      const float inverse_det = 1.0F / (j00 * j11 - j01 * j01);
      float ex = target_x - xd;
      float ey = target_y - yd;
      x += (j11 * ex - j01 * ey) * inverse_det;
      y += (j00 * ey - j01 * ex) * inverse_det;
      float u00 = 0.0F;
      float u01 = 0.0F;
      float u11 = 0.0F;
      distort<kind>(lens, x, y, xd, yd, u00, u01, u11);
      ex = target_x - xd;
      ey = target_y - yd;
      x += (j11 * ex - j01 * ey) * inverse_det;
      y += (j00 * ey - j01 * ex) * inverse_det;
    }
    const float inverse_s = 1.0F / (M[6] * x + M[7] * y + M[8]);
    const float a = (M[0] * x + M[1] * y + M[2]) * inverse_s;
    const float b = (M[3] * x + M[4] * y + M[5]) * inverse_s;
    s.ray_x[i] = x;
    s.ray_y[i] = y;
    // The nearest vertex, or the one below and left of it (adding 1.5 * 2^23 rounds).
    const float va = ((a - anchor_shift) + 12582912.0F) - 12582912.0F;
    const float vb = ((b - anchor_shift) + 12582912.0F) - 12582912.0F;
    const float va_low = va > 0.0F ? va : 0.0F;
    const float vb_low = vb > 0.0F ? vb : 0.0F;
    s.va[i] = va_low < last ? va_low : last;
    s.vb[i] = vb_low < last ? vb_low : last;
    s.vertex[i] = static_cast<std::int32_t>(s.vb[i]) * side + static_cast<std::int32_t>(s.va[i]);
  }
}

// The blurred pattern at a pixel and its derivatives by a and b. (a, b) is the place relative to
// the anchor.
//
// One edge per axis: with F the normal distributions of the distances to the vertex's two lines,
//   m = c0 + c1 Fa + c2 Fb + c3 F(a and b),   c3 the vertex's corner.
// Two or three per axis (lines 0, 1 or -1, 0, 1 from the anchor): c[4 * j + i] = the change of
// colour that the vertex of lines i and j makes, c[4 * j + 3] that of row j's line, c[12 + i] that
// of column i's, c[15] the colour below and left of all.
template <int reach, bool correlated>
PENUMBRA_INLINE float pattern(float a, float b, float ka, float kb, float rho,
                              const float* const* c, int i, float& m_a, float& m_b) {
  if constexpr (reach == 1) {
    const float ua = ka * a;
    const float ub = kb * b;
    float da = 0.0F;
    float db = 0.0F;
    const float Fa = normal_cdf(ua, da);
    const float Fb = normal_cdf(ub, db);
    if constexpr (correlated) {
      float dx = 0.0F;
      float dy = 0.0F;
      const float Fab = binormal_cdf(ua, ub, rho, Fa, Fb, da, db, dx, dy);
      m_a = ka * (c[1][i] * da + c[3][i] * dx);
      m_b = kb * (c[2][i] * db + c[3][i] * dy);
      return c[0][i] + c[1][i] * Fa + c[2][i] * Fb + c[3][i] * Fab;
    } else {
      m_a = ka * da * (c[1][i] + c[3][i] * Fb);
      m_b = kb * db * (c[2][i] + c[3][i] * Fa);
      return c[0][i] + c[1][i] * Fa + Fb * (c[2][i] + c[3][i] * Fa);
    }
  } else {
    constexpr float kFirst = reach == 3 ? -1.0F : 0.0F;
    float ua[reach];
    float ub[reach];
    float Fa[reach];
    float Fb[reach];
    float da[reach];
    float db[reach];
    float m = c[15][i];
    m_a = 0.0F;
    m_b = 0.0F;
#pragma GCC unroll 3
    for (int k = 0; k < reach; ++k) {
      ua[k] = ka * (a - (kFirst + static_cast<float>(k)));
      ub[k] = kb * (b - (kFirst + static_cast<float>(k)));
      Fa[k] = normal_cdf(ua[k], da[k]);
      Fb[k] = normal_cdf(ub[k], db[k]);
      m += c[12 + k][i] * Fa[k] + c[4 * k + 3][i] * Fb[k];
      m_a += c[12 + k][i] * da[k];
      m_b += c[4 * k + 3][i] * db[k];
    }
#pragma GCC unroll 3
    for (int row = 0; row < reach; ++row) {
#pragma GCC unroll 3
      for (int column = 0; column < reach; ++column) {
        const float corner = c[4 * row + column][i];
        if constexpr (correlated) {
          float dx = 0.0F;
          float dy = 0.0F;
          m += corner * binormal_cdf(ua[column], ub[row], rho, Fa[column], Fb[row], da[column],
                                     db[row], dx, dy);
          m_a += corner * dx;
          m_b += corner * dy;
        } else {
          m += corner * Fa[column] * Fb[row];
          m_a += corner * da[column] * Fb[row];
          m_b += corner * Fa[column] * db[row];
        }
      }
    }
    m_a *= ka;
    m_b *= kb;
    return m;
  }
}

template <int reach, bool correlated>
void accumulate_as(const AccumulateInput& in, const Samples& s, Sums& sums) {
  const float* M = in.lattice_from_ray;
  const float inverse_cz = 1.0F / in.centre[2];
  alignas(64) float J[8][kBlock];
  alignas(64) float W[8][kBlock];
  alignas(64) float weight[kBlock];
  alignas(64) float residual[kBlock];
  alignas(64) float weighted[kBlock];
  // The sums, lane by lane: 36 of H, 8 of g, cost, weight, base weight.
  constexpr int kSums = 47;
  alignas(64) float lanes[kSums][kLanes] = {};
  float(*const H)[kLanes] = lanes;
  float(*const g)[kLanes] = lanes + 36;
  float* const cost = lanes[44];
  float* const total = lanes[45];
  float* const base = lanes[46];
  for (int start = 0; start < s.count; start += kBlock) {
#pragma omp simd
    for (int l = 0; l < kBlock; ++l) {
      const int i = start + l;
      const float x = s.ray_x[i];
      const float y = s.ray_y[i];
      const float A = M[0] * x + M[1] * y + M[2];
      const float B = M[3] * x + M[4] * y + M[5];
      const float S = M[6] * x + M[7] * y + M[8];
      const float inverse_s = 1.0F / S;
      const float a = A * inverse_s;
      const float b = B * inverse_s;
      float m_a = 0.0F;
      float m_b = 0.0F;
      const float m =
          pattern<reach, correlated>(a - s.va[i], b - s.vb[i], s.ka[i], s.kb[i], s.rho[i],
                                     static_cast<const float* const*>(s.c), i, m_a, m_b);
      const float r = s.value[i] - (in.gain * m + in.offset);
      const float t = r * in.inverse_cutoff;
      const float inside = 1.0F - t * t;
      const float tukey = inside > 0.0F ? inside * inside : 0.0F;
      const float w = s.weight[i] * tukey;
      // A tag that moves by (nu, omega) carries its pattern along; along the fixed ray a changes by
      // -(1, 0, qa, qa b, -qa a, -b) . (nu, omega), and b alike.
      const float qa = (a - in.centre[0]) * inverse_cz;
      const float qb = (b - in.centre[1]) * inverse_cz;
      const float ja = -in.gain * m_a;
      const float jb = -in.gain * m_b;
      const float jz = ja * qa + jb * qb;
      J[0][l] = ja;
      J[1][l] = jb;
      J[2][l] = jz;
      J[3][l] = jz * b;
      J[4][l] = -jz * a;
      J[5][l] = jb * a - ja * b;
      J[6][l] = m;
      J[7][l] = 1.0F;
      weight[l] = w;
      residual[l] = r;
      s.residual[i] = r;
      weighted[l] = w * r;
    }
    for (int p = 0; p < 8; ++p) {
#pragma omp simd
      for (int l = 0; l < kBlock; ++l) W[p][l] = weight[l] * J[p][l];
    }
    int k = 0;
    for (int p = 0; p < 8; ++p) {
      for (int q = p; q < 8; ++q, ++k) {
#pragma omp simd
        for (int l = 0; l < kLanes; ++l) {
          H[k][l] += (W[p][l] * J[q][l] + W[p][l + kLanes] * J[q][l + kLanes]) +
                     (W[p][l + 2 * kLanes] * J[q][l + 2 * kLanes] +
                      W[p][l + 3 * kLanes] * J[q][l + 3 * kLanes]);
        }
      }
#pragma omp simd
      for (int l = 0; l < kLanes; ++l) {
        g[p][l] += (J[p][l] * weighted[l] + J[p][l + kLanes] * weighted[l + kLanes]) +
                   (J[p][l + 2 * kLanes] * weighted[l + 2 * kLanes] +
                    J[p][l + 3 * kLanes] * weighted[l + 3 * kLanes]);
      }
    }
#pragma omp simd
    for (int l = 0; l < kLanes; ++l) {
      for (int part = 0; part < kBlock; part += kLanes) {
        cost[l] += weighted[l + part] * residual[l + part];
        total[l] += weight[l + part];
        base[l] += s.weight[start + l + part];
      }
    }
  }
  // In double, by halves: with a block or two of samples this is as much work as the samples are.
  static_assert(kLanes == 16, "four halvings");
  alignas(64) double sum[kSums];
  for (int k = 0; k < kSums; ++k) {
    alignas(64) double part[kLanes / 2];
#pragma omp simd
    for (int l = 0; l < kLanes / 2; ++l)
      part[l] = static_cast<double>(lanes[k][l]) + static_cast<double>(lanes[k][l + kLanes / 2]);
#pragma omp simd
    for (int l = 0; l < kLanes / 4; ++l) part[l] += part[l + kLanes / 4];
    sum[k] = (part[0] + part[2]) + (part[1] + part[3]);
  }
  __builtin_memcpy(sums.H, sum, sizeof sums.H);
  __builtin_memcpy(sums.g, sum + 36, sizeof sums.g);
  sums.cost = sum[44];
  sums.weight = sum[45];
  sums.base_weight = sum[46];
}

template <int reach, bool correlated>
void evaluate_as(const AccumulateInput& in, const Samples& s) {
  const float* M = in.lattice_from_ray;
#pragma omp simd
  for (int i = 0; i < s.count; ++i) {
    const float x = s.ray_x[i];
    const float y = s.ray_y[i];
    const float inverse_s = 1.0F / (M[6] * x + M[7] * y + M[8]);
    const float a = (M[0] * x + M[1] * y + M[2]) * inverse_s;
    const float b = (M[3] * x + M[4] * y + M[5]) * inverse_s;
    float m_a = 0.0F;
    float m_b = 0.0F;
    s.model[i] = pattern<reach, correlated>(a - s.va[i], b - s.vb[i], s.ka[i], s.kb[i], s.rho[i],
                                            static_cast<const float* const*>(s.c), i, m_a, m_b);
  }
}

void project(const Lens& lens, const Blur& blur, const float* ray_from_lattice,
             const float* lattice_from_ray, const Vertices& vertices) {
  switch (lens.kind) {
    case Lens::Kind::none:
      project_as<Lens::Kind::none>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
      break;
    case Lens::Kind::polynomial:
      project_as<Lens::Kind::polynomial>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
      break;
    case Lens::Kind::rational:
      project_as<Lens::Kind::rational>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
      break;
    case Lens::Kind::fisheye:
      project_as<Lens::Kind::fisheye>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
      break;
  }
}

void prepare(const Lens& lens, const float* lattice_from_ray, int reach, int side,
             const Samples& samples) {
  switch (lens.kind) {
    case Lens::Kind::none:
      prepare_as<Lens::Kind::none>(lens, lattice_from_ray, reach, side, samples);
      break;
    case Lens::Kind::polynomial:
      prepare_as<Lens::Kind::polynomial>(lens, lattice_from_ray, reach, side, samples);
      break;
    case Lens::Kind::rational:
      prepare_as<Lens::Kind::rational>(lens, lattice_from_ray, reach, side, samples);
      break;
    case Lens::Kind::fisheye:
      prepare_as<Lens::Kind::fisheye>(lens, lattice_from_ray, reach, side, samples);
      break;
  }
}

void accumulate(const AccumulateInput& in, const Samples& samples, Sums& sums) {
  if (in.reach == 1) {
    in.correlated ? accumulate_as<1, true>(in, samples, sums)
                  : accumulate_as<1, false>(in, samples, sums);
  } else if (in.reach == 2) {
    in.correlated ? accumulate_as<2, true>(in, samples, sums)
                  : accumulate_as<2, false>(in, samples, sums);
  } else {
    in.correlated ? accumulate_as<3, true>(in, samples, sums)
                  : accumulate_as<3, false>(in, samples, sums);
  }
}

void evaluate(const AccumulateInput& in, const Samples& samples) {
  if (in.reach == 1) {
    in.correlated ? evaluate_as<1, true>(in, samples) : evaluate_as<1, false>(in, samples);
  } else if (in.reach == 2) {
    in.correlated ? evaluate_as<2, true>(in, samples) : evaluate_as<2, false>(in, samples);
  } else {
    in.correlated ? evaluate_as<3, true>(in, samples) : evaluate_as<3, false>(in, samples);
  }
}

// Sums of bytes in 16-bit lanes. The compiler's own widening of bytes goes through several
// shuffles; the instruction that does it in one is asked for by name where there is one.
#if defined(__AVX512BW__)
using Words = __m512i;
constexpr int kWordLanes = 32;
PENUMBRA_INLINE Words zero_words() {
  return _mm512_setzero_si512();
}
PENUMBRA_INLINE Words load_words(const std::uint8_t* bytes) {
  return _mm512_cvtepu8_epi16(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(bytes)));
}
PENUMBRA_INLINE Words add_words(Words a, Words b) {
  return _mm512_add_epi16(a, b);
}
PENUMBRA_INLINE Words subtract_words(Words a, Words b) {
  return _mm512_sub_epi16(a, b);
}
#elif defined(__AVX2__)
using Words = __m256i;
constexpr int kWordLanes = 16;
PENUMBRA_INLINE Words zero_words() {
  return _mm256_setzero_si256();
}
PENUMBRA_INLINE Words load_words(const std::uint8_t* bytes) {
  return _mm256_cvtepu8_epi16(_mm_loadu_si128(reinterpret_cast<const __m128i*>(bytes)));
}
PENUMBRA_INLINE Words add_words(Words a, Words b) {
  return _mm256_add_epi16(a, b);
}
PENUMBRA_INLINE Words subtract_words(Words a, Words b) {
  return _mm256_sub_epi16(a, b);
}
#else
using Words = std::int16_t __attribute__((vector_size(16)));
constexpr int kWordLanes = 8;
PENUMBRA_INLINE Words zero_words() {
  return Words{};
}
PENUMBRA_INLINE Words load_words(const std::uint8_t* bytes) {
  using Bytes = std::uint8_t __attribute__((vector_size(8)));
  Bytes packed;
  __builtin_memcpy(&packed, bytes, sizeof packed);
  return __builtin_convertvector(packed, Words);
}
PENUMBRA_INLINE Words add_words(Words a, Words b) {
  return a + b;
}
PENUMBRA_INLINE Words subtract_words(Words a, Words b) {
  return a - b;
}
#endif

template <int columns>
void search_as(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
               int count, int rows, int row_step, std::int16_t* scores) {
  constexpr int kParts = columns / kWordLanes;
  for (int row = 0; row < rows; ++row) {
    Words sum[kParts];
#pragma GCC unroll 8
    for (int part = 0; part < kParts; ++part) sum[part] = zero_words();
    for (int k = 0; k < positive; ++k) {
      const std::uint8_t* pixels = points[k] + row * row_step * strides[k];
#pragma GCC unroll 8
      for (int part = 0; part < kParts; ++part)
        sum[part] = add_words(sum[part], load_words(pixels + kWordLanes * part));
    }
    for (int k = positive; k < count; ++k) {
      const std::uint8_t* pixels = points[k] + row * row_step * strides[k];
#pragma GCC unroll 8
      for (int part = 0; part < kParts; ++part)
        sum[part] = subtract_words(sum[part], load_words(pixels + kWordLanes * part));
    }
    __builtin_memcpy(scores + row * columns, sum, sizeof sum);
  }
}

void search(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
            int count, int columns, int rows, int row_step, std::int16_t* scores) {
  if (columns == 32) {
    search_as<32>(points, strides, positive, count, rows, row_step, scores);
  } else {
    search_as<64>(points, strides, positive, count, rows, row_step, scores);
  }
}

}  // namespace

extern const Variant kVariant;
const Variant kVariant = {PENUMBRA_KERNEL_NAME, project, prepare, accumulate, evaluate, search};

#undef PENUMBRA_INLINE

}  // namespace penumbra::kernel::PENUMBRA_KERNEL
