// The body of alignment_kernel.hpp, included by one .cpp file per instruction set.
// PENUMBRA_KERNEL names the variant's namespace. Only builtins and plain arrays here.
#include "tracking/alignment/simd/alignment_kernel.hpp"

#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace penumbra::kernel::PENUMBRA_KERNEL {
namespace {

#define PENUMBRA_INLINE inline __attribute__((always_inline))

constexpr int kLanes = 16;

// As many floats as the instruction set has side by side.
#if defined(__AVX512F__)
constexpr int kWide = 16;
#elif defined(__AVX2__)
constexpr int kWide = 8;
#else
constexpr int kWide = 4;
#endif
using Wide = float __attribute__((vector_size(4 * kWide)));
using WideInts = std::int32_t __attribute__((vector_size(4 * kWide)));
static_assert(kLanes % kWide == 0);

PENUMBRA_INLINE Wide wide(float x) {
  return Wide{} + x;
}
PENUMBRA_INLINE Wide load(const float* at) {
  Wide x;
  __builtin_memcpy(&x, at, sizeof x);
  return x;
}
PENUMBRA_INLINE void store(float* at, const Wide& x) {
  __builtin_memcpy(at, &x, sizeof x);
}
PENUMBRA_INLINE Wide magnitude(const Wide& x) {
  return reinterpret_cast<Wide>(reinterpret_cast<WideInts>(x) & 0x7FFFFFFF);
}
PENUMBRA_INLINE float square_root(float x) {
  return __builtin_sqrtf(x);
}
PENUMBRA_INLINE Wide square_root(const Wide& x) {
  Wide root;
#pragma omp simd
  for (int l = 0; l < kWide; ++l) root[l] = __builtin_sqrtf(x[l]);
  return root;
}
// x where it is less, and where it is more; a limit for what is no number. By name, as the compiler
// has a limit that it knows go through comparisons and blends.
PENUMBRA_INLINE Wide least(const Wide& x, const Wide& limit) {
#if defined(__AVX512F__)
  return _mm512_maskz_min_ps(0xFFFF, x, limit);
#elif defined(__AVX2__)
  return _mm256_min_ps(x, limit);
#else
  return x < limit ? x : limit;
#endif
}
PENUMBRA_INLINE Wide most(const Wide& x, const Wide& limit) {
#if defined(__AVX512F__)
  return _mm512_maskz_max_ps(0xFFFF, x, limit);
#elif defined(__AVX2__)
  return _mm256_max_ps(x, limit);
#else
  return x > limit ? x : limit;
#endif
}
PENUMBRA_INLINE Wide by_sign(const Wide& u, const Wide& negative, const Wide& positive) {
  return reinterpret_cast<WideInts>(u) < 0 ? negative : positive;
}

// x0 y0 x1 y1 ..., as twice as many floats.
PENUMBRA_INLINE void store_pairs(float* at, const Wide& x, const Wide& y) {
#if defined(__AVX512F__)
  constexpr WideInts kLow = {0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23};
#elif defined(__AVX2__)
  constexpr WideInts kLow = {0, 8, 1, 9, 2, 10, 3, 11};
#else
  constexpr WideInts kLow = {0, 4, 1, 5};
#endif
  store(at, __builtin_shuffle(x, y, kLow));
  store(at + kWide, __builtin_shuffle(x, y, kLow + kWide / 2));
}

// exp(-x) for x >= 0, relative error under 3e-7: 2^-n by the exponent bits, a polynomial for the
// rest. Flushes to about 1e-35.
PENUMBRA_INLINE Wide exp_negative(const Wide& x) {
  const Wide scaled = least(x, wide(80.0F)) * -1.44269504F;
  // Adding 1.5 * 2^23 rounds to the nearest integer and leaves it in the low bits.
  const Wide shifted = scaled + 12582912.0F;
  const Wide n = shifted - 12582912.0F;
  const Wide f = (scaled - n) * 0.69314718F;  // in [-0.35, 0.35]
  const Wide p =
      1.0F +
      f * (1.0F + f * (0.5F + f * (0.16666667F +
                                   f * (0.04166667F + f * (0.00833333F + f * 0.00138889F)))));
  // Onto the exponent, which what is above the low bits falls off.
  return reinterpret_cast<Wide>(reinterpret_cast<WideInts>(p) +
                                (reinterpret_cast<WideInts>(shifted) << 23));
}

// Normal distribution and its density: Abramowitz and Stegun 7.1.25, error under 1.3e-5.
PENUMBRA_INLINE Wide normal_cdf(const Wide& u, Wide& density) {
  const Wide t = magnitude(u) * 0.70710678F;
  const Wide e = exp_negative(t * t);
  const Wide q = 1.0F / (1.0F + 0.47047F * t);
  const Wide tail = 0.5F * e * q * (0.3480242F + q * (-0.0958798F + q * 0.7478556F));
  density = 0.39894228F * e;
  return by_sign(u, tail, 1.0F - tail);
}

// Bivariate normal distribution: product plus an integral over the correlation (Plackett), with
// r = sin(theta), by three Gauss-Legendre nodes. d_x, d_y: derivatives.
PENUMBRA_INLINE Wide binormal_cdf(const Wide& x, const Wide& y, const Wide& rho, const Wide& cdf_x,
                                  const Wide& cdf_y, const Wide& density_x, const Wide& density_y,
                                  Wide& d_x, Wide& d_y) {
  constexpr float kNode[3] = {0.11270167F, 0.5F, 0.88729833F};
  constexpr float kWeight[3] = {0.27777778F, 0.44444444F, 0.27777778F};
  // asin for |rho| <= 0.95: Abramowitz and Stegun 4.4.45, error under 7e-5.
  const Wide r = magnitude(rho);
  const Wide arc = 1.5707288F + r * (-0.2121144F + r * (0.0742610F - r * 0.0187293F));
  const Wide angle_abs = 1.5707963F - square_root(1.0F - r) * arc;
  const Wide angle = by_sign(rho, -angle_abs, angle_abs);
  const Wide squares = 0.5F * (x * x + y * y);
  const Wide product = x * y;
  Wide integral = {};
#pragma GCC unroll 3
  for (int k = 0; k < 3; ++k) {
    const Wide theta = angle * kNode[k];
    const Wide t2 = theta * theta;
    // sin by its series; |theta| < 1.26
    const Wide s =
        theta *
        (1.0F + t2 * (-0.16666667F + t2 * (0.00833333F + t2 * (-0.00019841F + t2 * 2.7557e-6F))));
    const Wide inverse = 1.0F / (1.0F - s * s);
    const Wide z = (squares - product * s) * inverse;
    integral += kWeight[k] * exp_negative(most(z, Wide{}));
  }
  const Wide root = 1.0F / square_root(1.0F - rho * rho);
  Wide unused;
  d_x = density_x * normal_cdf((y - rho * x) * root, unused);
  d_y = density_y * normal_cdf((x - rho * y) * root, unused);
  return cdf_x * cdf_y + angle * 0.15915494F * integral;
}

// Four rows of four -> their columns, or back.
using Floats4 = float __attribute__((vector_size(16)));
PENUMBRA_INLINE void transpose(Floats4 (&rows)[4]) {
  using Places = std::int32_t __attribute__((vector_size(16)));
  const Floats4 low01 = __builtin_shuffle(rows[0], rows[1], Places{0, 4, 1, 5});
  const Floats4 low23 = __builtin_shuffle(rows[2], rows[3], Places{0, 4, 1, 5});
  const Floats4 high01 = __builtin_shuffle(rows[0], rows[1], Places{2, 6, 3, 7});
  const Floats4 high23 = __builtin_shuffle(rows[2], rows[3], Places{2, 6, 3, 7});
  rows[0] = __builtin_shuffle(low01, low23, Places{0, 1, 4, 5});
  rows[1] = __builtin_shuffle(low01, low23, Places{2, 3, 6, 7});
  rows[2] = __builtin_shuffle(high01, high23, Places{0, 1, 4, 5});
  rows[3] = __builtin_shuffle(high01, high23, Places{2, 3, 6, 7});
}

// In what follows a Value is a float or a Wide.
template <class Value>
PENUMBRA_INLINE Value arc_tangent(const Value& r) {  // of r >= 0; Abramowitz and Stegun 4.4.49
  const auto large = r > 1.0F;
  const Value x = large ? 1.0F / r : r;
  const Value z = x * x;
  Value p = z * 0.0028662257F - 0.0161657367F;
  p = p * z + 0.0429096138F;
  p = p * z - 0.0752896400F;
  p = p * z + 0.1065626393F;
  p = p * z - 0.1420889944F;
  p = p * z + 0.1999355085F;
  p = p * z - 0.3333314528F;
  p = x + x * z * p;
  return large ? 1.57079633F - p : p;
}

// Distorted coordinates and their derivative (see core/camera/camera_model.hpp).
template <Lens::Kind kind, class Value>
PENUMBRA_INLINE void distort(const Lens& lens, const Value& x, const Value& y, Value& xd, Value& yd,
                             Value& j00, Value& j01, Value& j11) {
  const Value r2 = x * x + y * y;
  const float* k = lens.k;
  if constexpr (kind == Lens::Kind::none) {
    xd = x;
    yd = y;
    j00 = Value{} + 1.0F;
    j01 = Value{};
    j11 = Value{} + 1.0F;
  } else if constexpr (kind != Lens::Kind::fisheye) {
    Value radial = 1.0F + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    Value d_radial = k[0] + r2 * (2.0F * k[1] + r2 * 3.0F * k[4]);
    if constexpr (kind == Lens::Kind::rational) {
      const Value inverse = 1.0F / (1.0F + r2 * (k[5] + r2 * (k[6] + r2 * k[7])));
      const Value d_denominator = k[5] + r2 * (2.0F * k[6] + r2 * 3.0F * k[7]);
      radial *= inverse;
      d_radial = (d_radial - radial * d_denominator) * inverse;
    }
    const Value xy2 = 2.0F * x * y;
    xd = x * radial + k[2] * xy2 + k[3] * (r2 + 2.0F * x * x);
    yd = y * radial + k[2] * (r2 + 2.0F * y * y) + k[3] * xy2;
    j00 = radial + 2.0F * x * x * d_radial + 2.0F * k[2] * y + 6.0F * k[3] * x;
    j01 = xy2 * d_radial + 2.0F * (k[2] * x + k[3] * y);
    j11 = radial + 2.0F * y * y * d_radial + 6.0F * k[2] * y + 2.0F * k[3] * x;
  } else {
    const Value least2 = Value{} + 1e-8F;
    const Value r2_safe = r2 > least2 ? r2 : least2;
    const Value r = square_root(r2_safe);
    const Value t = arc_tangent(r);
    const Value t2 = t * t;
    const Value theta_d = t * (1.0F + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    const Value d_theta_d =
        1.0F + t2 * (3.0F * k[0] + t2 * (5.0F * k[1] + t2 * (7.0F * k[2] + t2 * 9.0F * k[3])));
    const Value scale = theta_d / r;
    const Value d_scale = (d_theta_d / (1.0F + r2_safe) - scale) / r2_safe;
    xd = scale * x;
    yd = scale * y;
    j00 = scale + d_scale * x * x;
    j01 = d_scale * x * y;
    j11 = scale + d_scale * y * y;
  }
}

// What is wanted of vertices.
enum class Wanted {
  places,           // pixels and depths
  spread,           // rays and blur too, of a blur that goes no way between the axes
  slanting_spread,  // of any
  correlation,      // and that of the blur along the lattice's directions
};

template <Lens::Kind kind, Wanted wanted>
void project_as(const Lens& lens_in, const Blur& blur, const float* M_in, const float* N_in,
                const Vertices& v_in) {
  // Copies, which the floats that are written are not.
  const Lens lens = lens_in;
  const Vertices v = v_in;
  float M[9];
  float N[9];
  for (int k = 0; k < 9; ++k) {
    M[k] = M_in[k];
    N[k] = N_in[k];
  }
  const float inverse_fx = 1.0F / lens.fx;
  const float inverse_fy = 1.0F / lens.fy;
  const float mxx = blur.motion_x_px * blur.motion_x_px * (1.0F / 12.0F);
  const float mxy = blur.motion_x_px * blur.motion_y_px * (1.0F / 12.0F);
  const float myy = blur.motion_y_px * blur.motion_y_px * (1.0F / 12.0F);
  const float cxx = blur.variance_px2 + mxx;
  const float cyy = blur.variance_px2 + myy;
#pragma GCC unroll 1
  for (int i = 0; i < v.count; i += kWide) {
    const Wide a = load(v.a + i);
    const Wide b = load(v.b + i);
    const Wide X = M[0] * a + M[1] * b + M[2];
    const Wide Y = M[3] * a + M[4] * b + M[5];
    const Wide Z = M[6] * a + M[7] * b + M[8];
    const Wide inverse = 1.0F / most(Z, wide(1e-9F));
    const Wide x = X * inverse;
    const Wide y = Y * inverse;
    Wide xd;
    Wide yd;
    Wide j00;
    Wide j01;
    Wide j11;
    distort<kind>(lens, x, y, xd, yd, j00, j01, j11);
    store(v.pixel_x + i, lens.fx * xd + lens.cx);
    store(v.pixel_y + i, lens.fy * yd + lens.cy);
    store(v.depth + i, x * x + y * y < lens.max_radius2 ? Z : wide(-1.0F));
    if constexpr (wanted == Wanted::places) continue;
    store(v.ray_x + i, x);
    store(v.ray_y + i, y);
    // d(a, b) / d ray, then by the pixel
    const Wide inverse_s = 1.0F / (N[6] * x + N[7] * y + N[8]);
    const Wide ax = (N[0] - a * N[6]) * inverse_s;
    const Wide ay = (N[1] - a * N[7]) * inverse_s;
    const Wide bx = (N[3] - b * N[6]) * inverse_s;
    const Wide by = (N[4] - b * N[7]) * inverse_s;
    Wide au = ax;
    Wide av = ay;
    Wide bu = bx;
    Wide bv = by;
    if constexpr (kind != Lens::Kind::none) {
      const Wide inverse_det = 1.0F / (j00 * j11 - j01 * j01);
      const Wide i00 = j11 * inverse_det;
      const Wide i01 = -j01 * inverse_det;
      const Wide i11 = j00 * inverse_det;
      au = ax * i00 + ay * i01;
      av = ax * i01 + ay * i11;
      bu = bx * i00 + by * i01;
      bv = bx * i01 + by * i11;
    }
    au *= inverse_fx;
    av *= inverse_fy;
    bu *= inverse_fx;
    bv *= inverse_fy;
    constexpr bool kSlanting = wanted != Wanted::spread;
    Wide var_a = au * au * cxx;
    Wide var_b = bu * bu * cxx;
    if constexpr (kSlanting) {
      var_a += 2.0F * au * av * mxy;
      var_b += 2.0F * bu * bv * mxy;
    }
    var_a += av * av * cyy;
    var_b += bv * bv * cyy;
    const Wide ka = 1.0F / square_root(var_a);
    const Wide kb = 1.0F / square_root(var_b);
    store(v.ka + i, ka);
    store(v.kb + i, kb);
    if constexpr (wanted == Wanted::correlation) {
      const Wide cov = au * bu * cxx + (au * bv + av * bu) * mxy + av * bv * cyy;
      store(v.rho + i, most(least(cov * ka * kb, wide(0.95F)), wide(-0.95F)));
    }
  }
}

template <Lens::Kind kind>
void project_of(const Lens& lens, const Blur& blur, const float* M, const float* N,
                const Vertices& v) {
  if (v.ka == nullptr) {
    project_as<kind, Wanted::places>(lens, blur, M, N, v);
  } else if (v.rho != nullptr) {
    project_as<kind, Wanted::correlation>(lens, blur, M, N, v);
  } else if (blur.motion_x_px * blur.motion_y_px != 0.0F) {
    project_as<kind, Wanted::slanting_spread>(lens, blur, M, N, v);
  } else {
    project_as<kind, Wanted::spread>(lens, blur, M, N, v);
  }
}

// Of |x| < 2^22; a whole number may go down by one.
PENUMBRA_INLINE float round_down(float x) {
  return ((x - 0.5F) + 12582912.0F) - 12582912.0F;
}

constexpr int kSteps = 16;  // that are placed at a time
struct StepBlock {
  alignas(64) float a[kSteps], b[kSteps], walk[kSteps], cross[kSteps], ray_x[kSteps], ray_y[kSteps];
  alignas(64) std::int32_t cell[kSteps], rows[kSteps], place[kSteps];
};

template <Lens::Kind kind, bool along_x, bool band>
PENUMBRA_INLINE void place_steps(const Lens& lens, const Walk& w, StepBlock& block) {
  const float* M = w.ray_from_lattice;
  const float to_x = w.along_b ? M[1] : M[0];
  const float to_y = w.along_b ? M[4] : M[3];
  const float to_z = w.along_b ? M[7] : M[6];
  const auto walk_limit = static_cast<float>(along_x ? w.width : w.height);
  const auto cross_limit = static_cast<float>(along_x ? w.height : w.width);
  const auto walk_bytes = static_cast<std::int32_t>(along_x ? 1 : w.stride);
  const auto cross_bytes = static_cast<std::int32_t>(along_x ? w.stride : 1);
  const float band_first = w.offsets[0];
  const float band_last = w.offsets[band ? w.band_count - 1 : 0];
  const auto most = static_cast<float>(w.most_rows);
#pragma omp simd
  for (int i = 0; i < kSteps; ++i) {
    const float a = block.a[i];
    const float b = block.b[i];
    const float Z = M[6] * a + M[7] * b + M[8];
    const float inverse = 1.0F / (Z > 1e-9F ? Z : 1e-9F);
    const float x = (M[0] * a + M[1] * b + M[2]) * inverse;
    const float y = (M[3] * a + M[4] * b + M[5]) * inverse;
    float xd = 0.0F;
    float yd = 0.0F;
    float j00 = 0.0F;
    float j01 = 0.0F;
    float j11 = 0.0F;
    distort<kind>(lens, x, y, xd, yd, j00, j01, j11);
    // The pixel and the edge's direction there; later rows are seen later.
    const float dx = (to_x - x * to_z) * inverse;
    const float dy = (to_y - y * to_z) * inverse;
    float u = lens.fx * xd + lens.cx;
    float v = lens.fy * yd + lens.cy;
    float du = lens.fx * (j00 * dx + j01 * dy);
    float dv = lens.fy * (j01 * dx + j11 * dy);
    const float rows_later = v - w.row;
    u += w.shear_x * rows_later;
    v += w.shear_y * rows_later;
    du += w.shear_x * dv;
    dv += w.shear_y * dv;
    const float slope = along_x ? dv / du : du / dv;
    const float along = along_x ? u : v;
    const float walk = (along + 12582912.0F) - 12582912.0F;
    const float centre = (along_x ? v : u) + slope * (walk - along);
    float first = 0.0F;
    float rows = 0.0F;
    float low = 0.0F;
    float high = 0.0F;
    if constexpr (band) {
      first = round_down(centre);
      rows = static_cast<float>(w.band_count);
      low = first + band_first;
      high = first + band_last;
    } else {
      const float wide = w.reach_px * __builtin_sqrtf(1.0F + slope * slope);
      const float reach = wide < 8.0F ? wide : 8.0F;
      first = -round_down(reach - centre);
      const float all = round_down(centre + reach) - first + 1.0F;
      rows = all < most ? all : most;
      low = first;
      high = first + rows - 1.0F;
    }
    const bool seen = (Z > 1e-9F) & (x * x + y * y < lens.max_radius2) & (walk >= 0.0F) &
                      (walk < walk_limit) & (low >= 0.0F) & (high < cross_limit) & (rows > 0.0F);
    const float walk_seen = seen ? walk : 0.0F;
    const float first_seen = seen ? first : 0.0F;
    block.walk[i] = walk_seen;
    block.cross[i] = first_seen;
    block.ray_x[i] = x;
    block.ray_y[i] = y;
    block.rows[i] = static_cast<std::int32_t>(seen ? rows : 0.0F);
    block.place[i] = static_cast<std::int32_t>(walk_seen) * walk_bytes +
                     static_cast<std::int32_t>(first_seen) * cross_bytes;
  }
}

// Where the samples of steps are written to.
struct StepOutput {
  float* walk;
  float* cross;
  float* ray_x;
  float* ray_y;
  std::int32_t* place;
  std::int32_t* end;
};

// How many rows there are changes from step to step, and no processor foresees it: always four or
// eight are written, those too many over again by the next step.
template <bool with_rays, bool one_group>
__attribute__((noinline)) int write_steps(const StepBlock& block, int steps, const float* offsets,
                                          std::int32_t cross_bytes, const StepOutput& out,
                                          int used) {
  using Four = float __attribute__((vector_size(16)));
  using Places = std::int32_t __attribute__((vector_size(16)));
  float* const __restrict walk_out = out.walk;
  float* const __restrict cross_out = out.cross;
  float* const __restrict x_out = out.ray_x;
  float* const __restrict y_out = out.ray_y;
  std::int32_t* const __restrict place_out = out.place;
  std::int32_t* const __restrict end_out = out.end;
  Four first_offsets;
  __builtin_memcpy(&first_offsets, offsets, sizeof first_offsets);
  const Places first_places = __builtin_convertvector(first_offsets, Places) * cross_bytes;
  std::ptrdiff_t at = used;
  for (int l = 0; l < steps; ++l) {
    const float walk = block.walk[l];
    const float first = block.cross[l];
    const std::int32_t place = block.place[l];
    const Four walk_4 = {walk, walk, walk, walk};
    const Four first_4 = {first, first, first, first};
    const Places place_4 = {place, place, place, place};
    const Four cross_4 = first_4 + first_offsets;
    const Places places_4 = place_4 + first_places;
    __builtin_memcpy(walk_out + at, &walk_4, sizeof walk_4);
    __builtin_memcpy(cross_out + at, &cross_4, sizeof cross_4);
    __builtin_memcpy(place_out + at, &places_4, sizeof places_4);
    if constexpr (with_rays) {
      const float x = block.ray_x[l];
      const float y = block.ray_y[l];
      const Four x_4 = {x, x, x, x};
      const Four y_4 = {y, y, y, y};
      __builtin_memcpy(x_out + at, &x_4, sizeof x_4);
      __builtin_memcpy(y_out + at, &y_4, sizeof y_4);
    }
    const std::int32_t rows = block.rows[l];
    if constexpr (!one_group) {
      for (int i = 4; i < rows; i += 4) {
        Four more;
        __builtin_memcpy(&more, offsets + i, sizeof more);
        const Four cross_i = first_4 + more;
        const Places places_i = place_4 + __builtin_convertvector(more, Places) * cross_bytes;
        __builtin_memcpy(walk_out + at + i, &walk_4, sizeof walk_4);
        __builtin_memcpy(cross_out + at + i, &cross_i, sizeof cross_i);
        __builtin_memcpy(place_out + at + i, &places_i, sizeof places_i);
        if constexpr (with_rays) {
          const float x = block.ray_x[l];
          const float y = block.ray_y[l];
          const Four x_4 = {x, x, x, x};
          const Four y_4 = {y, y, y, y};
          __builtin_memcpy(x_out + at + i, &x_4, sizeof x_4);
          __builtin_memcpy(y_out + at + i, &y_4, sizeof y_4);
        }
      }
    }
    at += rows;
    end_out[l] = static_cast<std::int32_t>(at);
  }
  return static_cast<int>(at);
}

template <Lens::Kind kind, bool along_x, bool band>
int walk_as(const Lens& lens, const Walk& w, const Samples& s, int used) {
  StepBlock block;
  float* const going = w.along_b ? block.b : block.a;
  float* const fixed = w.along_b ? block.a : block.b;
  const float cells_per_step = static_cast<float>(w.cell_count) / static_cast<float>(w.count);
  const auto cross_bytes = static_cast<std::int32_t>(along_x ? w.stride : 1);
  StepOutput out = {along_x ? s.pixel_x : s.pixel_y,
                    along_x ? s.pixel_y : s.pixel_x,
                    s.ray_x,
                    s.ray_y,
                    s.vertex,
                    w.end};
  const int last_cell = w.cell_count;
  for (int begin = 0; begin < w.count; begin += kSteps) {
#pragma omp simd
    for (int l = 0; l < kSteps; ++l) {
      const float at = cells_per_step * (static_cast<float>(begin + l) + 0.5F);
      const auto cell = static_cast<std::int32_t>(at);
      going[l] = at;
      block.cell[l] = cell < last_cell ? cell : last_cell;
    }
    for (int l = 0; l < kSteps; ++l) {
      const Walk::Cell& cell = w.cells[block.cell[l]];
      going[l] += cell.begin;
      fixed[l] = cell.across;
      w.run[begin + l] = cell.run;
    }
    place_steps<kind, along_x, band>(lens, w, block);
    const int steps = w.count - begin < kSteps ? w.count - begin : kSteps;
    // Without distortion a ray is known from its pixel.
    constexpr bool kRays = kind != Lens::Kind::none;
    used = w.most_rows <= 4
               ? write_steps<kRays, true>(block, steps, w.offsets, cross_bytes, out, used)
               : write_steps<kRays, false>(block, steps, w.offsets, cross_bytes, out, used);
    out.end += kSteps;
  }
  return used;
}

template <Lens::Kind kind>
int walk_of(const Lens& lens, const Walk& w, const Samples& s, int used) {
  if (w.along_x) {
    return w.band_count > 0 ? walk_as<kind, true, true>(lens, w, s, used)
                            : walk_as<kind, true, false>(lens, w, s, used);
  }
  return w.band_count > 0 ? walk_as<kind, false, true>(lens, w, s, used)
                          : walk_as<kind, false, false>(lens, w, s, used);
}

int walk(const Lens& lens, const Walk& w, const Samples& s, int used) {
  switch (lens.kind) {
    case Lens::Kind::none:
      return walk_of<Lens::Kind::none>(lens, w, s, used);
    case Lens::Kind::polynomial:
      return walk_of<Lens::Kind::polynomial>(lens, w, s, used);
    case Lens::Kind::rational:
      return walk_of<Lens::Kind::rational>(lens, w, s, used);
    case Lens::Kind::fisheye:
      break;
  }
  return walk_of<Lens::Kind::fisheye>(lens, w, s, used);
}

// Double precision, as floats at the far end of a run may round to another pixel than its start's.
void measure_runs(const RunWalk& w, double& along_px, double& across_px) {
  constexpr int kRuns = RunWalk::Part::kRuns;
  along_px = 0.0;
  across_px = 0.0;
  for (int begin = 0; begin < w.count; begin += kRuns) {
    RunWalk::Part& part = w.parts[begin / kRuns];
    const int runs = w.count - begin < kRuns ? w.count - begin : kRuns;
    alignas(64) float from_x[kRuns], from_y[kRuns], to_x[kRuns], to_y[kRuns], depth[kRuns];
    alignas(64) float ray_x[kRuns], ray_y[kRuns], to_ray_x[kRuns], to_ray_y[kRuns];
    for (int l = 0; l < kRuns; ++l) {
      const RunWalk::Run& run = w.runs[begin + (l < runs ? l : runs - 1)];
      from_x[l] = w.pixel_x[run.begin];
      from_y[l] = w.pixel_y[run.begin];
      to_x[l] = w.pixel_x[run.end];
      to_y[l] = w.pixel_y[run.end];
      ray_x[l] = w.ray_x[run.begin];
      ray_y[l] = w.ray_y[run.begin];
      to_ray_x[l] = w.ray_x[run.end];
      to_ray_y[l] = w.ray_y[run.end];
      const float depth0 = w.depth[run.begin];
      const float depth1 = w.depth[run.end];
      depth[l] = depth0 < depth1 ? depth0 : depth1;
    }
#pragma omp simd
    for (int l = 0; l < kRuns; ++l) {
      const float dx = __builtin_fabsf(to_x[l] - from_x[l]);
      const float dy = __builtin_fabsf(to_y[l] - from_y[l]);
      const bool seen = depth[l] > 0.0F;
      part.along_px[l] = static_cast<double>(seen ? (dx < dy ? dy : dx) : 0.0F);
      part.across_px[l] = static_cast<double>(seen ? (dy < dx ? dy : dx) : 0.0F);
      const float x = __builtin_fabsf(from_x[l]);
      const float y = __builtin_fabsf(from_y[l]);
      const float u = __builtin_fabsf(to_x[l]);
      const float v = __builtin_fabsf(to_y[l]);
      const bool near = (x < 1e5F) & (y < 1e5F) & (u < 1e5F) & (v < 1e5F);
      const double x0 = static_cast<double>(from_x[l]);
      const double y0 = static_cast<double>(from_y[l]);
      const double x1 = static_cast<double>(to_x[l]);
      const double y1 = static_cast<double>(to_y[l]);
      const double step_x = __builtin_fabs(x1 - x0);
      const double step_y = __builtin_fabs(y1 - y0);
      const bool along_x = step_x >= step_y;
      const double length = along_x ? step_x : step_y;
      const double along0 = along_x ? x0 : y0;
      const double along1 = along_x ? x1 : y1;
      const double across0 = along_x ? y0 : x0;
      const double across1 = along_x ? y1 : x1;
      const double inverse = 1.0 / length;
      const double slope = (across1 - across0) * inverse;
      const double wide = w.reach_px * __builtin_sqrt(1.0 + slope * slope);
      part.length[l] = seen & near & (length > 1e-6) ? length : -1.0;
      part.along[l] = along0;
      part.across[l] = across0;
      part.direction[l] = along1 < along0 ? -1.0 : 1.0;
      part.slope[l] = slope;
      part.reach[l] = wide < 8.0 ? wide : 8.0;
      part.along_x[l] = along_x ? 1 : 0;
      const double rx = static_cast<double>(ray_x[l]);
      const double ry = static_cast<double>(ray_y[l]);
      part.ray_x[l] = rx;
      part.ray_y[l] = ry;
      part.per_px_x[l] = (static_cast<double>(to_ray_x[l]) - rx) * inverse;
      part.per_px_y[l] = (static_cast<double>(to_ray_y[l]) - ry) * inverse;
    }
    for (int l = 0; l < runs; ++l) {
      along_px += part.along_px[l];
      across_px += part.across_px[l];
    }
  }
}

// Steps of runs that are walked along the same axis, with what is known of their runs.
struct RunSteps {
  static constexpr int kRoom = kSteps + 4;  // runs are written four steps at a time
  alignas(64) double at[kRoom], along[kRoom], across[kRoom], direction[kRoom], slope[kRoom];
  alignas(64) double reach[kRoom], ray_x[kRoom], ray_y[kRoom], per_px_x[kRoom], per_px_y[kRoom];
};

// Rounded down, of |x| < 2^20.
PENUMBRA_INLINE std::int32_t floor_of_double(double x) {
  constexpr std::int32_t kShift = 1 << 20;
  return static_cast<std::int32_t>(x + kShift) - kShift;
}

template <bool along_x, bool band, bool with_rays>
PENUMBRA_INLINE void place_run_steps(const RunWalk& w, const RunSteps& steps, StepBlock& block) {
  const std::int32_t walk_limit = along_x ? w.width : w.height;
  const std::int32_t cross_limit = along_x ? w.height : w.width;
  const auto walk_bytes = static_cast<std::int32_t>(along_x ? 1 : w.stride);
  const auto cross_bytes = static_cast<std::int32_t>(along_x ? w.stride : 1);
  const auto band_first = static_cast<std::int32_t>(w.offsets[0]);
  const auto band_last = static_cast<std::int32_t>(w.offsets[band ? w.band_count - 1 : 0]);
  const std::int32_t most = w.most_rows;
  const std::int32_t band_rows = w.band_count;
#pragma omp simd
  for (int i = 0; i < kSteps; ++i) {
    const std::int32_t walk =
        floor_of_double(steps.along[i] + steps.direction[i] * steps.at[i] + 0.5);
    // Where this pixel's centre is along the run.
    const double exact = steps.direction[i] * (static_cast<double>(walk) - steps.along[i]);
    const double centre = steps.across[i] + steps.slope[i] * exact;
    std::int32_t first = 0;
    std::int32_t rows = 0;
    std::int32_t low = 0;
    std::int32_t high = 0;
    if constexpr (band) {
      first = floor_of_double(centre);
      rows = band_rows;
      low = first + band_first;
      high = first + band_last;
    } else {
      first = -floor_of_double(-(centre - steps.reach[i]));
      const std::int32_t all = floor_of_double(centre + steps.reach[i]) - first + 1;
      const std::int32_t some = all < most ? all : most;
      rows = some > 0 ? some : 0;
      low = first;
      high = first + rows - 1;
    }
    const bool seen = (walk >= 0) & (walk < walk_limit) & (low >= 0) & (high < cross_limit);
    const std::int32_t walk_seen = seen ? walk : 0;
    const std::int32_t first_seen = seen ? first : 0;
    block.walk[i] = static_cast<float>(walk_seen);
    block.cross[i] = static_cast<float>(first_seen);
    block.rows[i] = seen ? rows : 0;
    block.place[i] = walk_seen * walk_bytes + first_seen * cross_bytes;
    if constexpr (with_rays) {
      block.ray_x[i] = static_cast<float>(steps.ray_x[i] + steps.per_px_x[i] * exact);
      block.ray_y[i] = static_cast<float>(steps.ray_y[i] + steps.per_px_y[i] * exact);
    }
  }
}

PENUMBRA_INLINE void repeat(double* to, int begin, int end, double value) {
  using Two = double __attribute__((vector_size(16)));
  const Two two = {value, value};
  for (int i = begin; i < end; i += 4) {
    __builtin_memcpy(to + i, &two, sizeof two);
    __builtin_memcpy(to + i + 2, &two, sizeof two);
  }
}

template <bool band, bool with_rays>
int walk_runs_as(RunWalk& w, const Samples& s) {
  constexpr int kRuns = RunWalk::Part::kRuns;
  StepBlock block = {};
  RunSteps steps = {};
  std::int32_t ends[kSteps];
  // Of the runs that end in a block: which one, and how many of the block's steps precede the end,
  // one at least: where a run fills a block and goes on, the next block begins with its steps.
  std::int32_t ended[kSteps + 1];
  int ended_at[kSteps + 1];
  int used = 0;
  w.walked = 0;
  bool begun = false;             // the run has a step
  double at = 0.5 * w.stride_px;  // along the run
  for (int k = 0; k < w.count;) {
    int count = 0;
    int ended_count = 0;
    std::int32_t along_x = 0;
    while (k < w.count) {
      const RunWalk::Part& part = w.parts[k / kRuns];
      const int l = k % kRuns;
      const double length = part.length[l];
      if (at >= length) {
        if (length > 0.0) at -= length;
        if (begun) {
          ended[ended_count] = k;
          ended_at[ended_count++] = count;
          begun = false;
        }
        ++k;
        continue;
      }
      if (count == kSteps || (count > 0 && part.along_x[l] != along_x)) break;
      along_x = part.along_x[l];
      const int first = count;
      do {
        steps.at[count++] = at;
        at += w.stride_px;
      } while (at < length && count < kSteps);
      begun = true;
      repeat(steps.along, first, count, part.along[l]);
      repeat(steps.across, first, count, part.across[l]);
      repeat(steps.direction, first, count, part.direction[l]);
      repeat(steps.slope, first, count, part.slope[l]);
      if constexpr (!band) repeat(steps.reach, first, count, part.reach[l]);
      if constexpr (with_rays) {
        repeat(steps.ray_x, first, count, part.ray_x[l]);
        repeat(steps.ray_y, first, count, part.ray_y[l]);
        repeat(steps.per_px_x, first, count, part.per_px_x[l]);
        repeat(steps.per_px_y, first, count, part.per_px_y[l]);
      }
    }
    if (count > 0) {
      StepOutput out = {s.pixel_x, s.pixel_y, s.ray_x, s.ray_y, s.vertex, ends};
      std::int32_t cross_bytes = 1;
      if (along_x != 0) {
        place_run_steps<true, band, with_rays>(w, steps, block);
        cross_bytes = static_cast<std::int32_t>(w.stride);
      } else {
        place_run_steps<false, band, with_rays>(w, steps, block);
        out.walk = s.pixel_y;
        out.cross = s.pixel_x;
      }
      used = w.most_rows <= 4
                 ? write_steps<with_rays, true>(block, count, w.offsets, cross_bytes, out, used)
                 : write_steps<with_rays, false>(block, count, w.offsets, cross_bytes, out, used);
    }
    for (int i = 0; i < ended_count; ++i) {
      w.run[w.walked] = ended[i];
      w.end[w.walked] = ends[ended_at[i] - 1];
      ++w.walked;
    }
  }
  return used;
}

int walk_runs(const Lens& lens, RunWalk& w, const Samples& s) {
  // Without distortion a ray is known from its pixel.
  if (lens.kind == Lens::Kind::none)
    return w.band_count > 0 ? walk_runs_as<true, false>(w, s) : walk_runs_as<false, false>(w, s);
  return w.band_count > 0 ? walk_runs_as<true, true>(w, s) : walk_runs_as<false, true>(w, s);
}

void read(const std::uint8_t* pixels, const float* levels, int used, const Samples& s) {
  const std::int32_t* const __restrict place = s.vertex;
  float* const __restrict value = s.value;
#pragma GCC unroll 4
  for (int i = 0; i < used; ++i) value[i] = levels[pixels[place[i]]];
  float* const __restrict weight = s.weight;
#pragma omp simd
  for (int i = 0; i < used; ++i) weight[i] = 1.0F;
  const int left = s.count - used;
  if (left == 0) return;
  float* const arrays[] = {s.pixel_x, s.pixel_y, s.ray_x, s.ray_y, s.value, s.weight};
#pragma GCC unroll 6
  for (int k = 0; k < 6; ++k) {
    float* const __restrict to = arrays[k] + used;
    const float last = k < 4 && used > 0 ? to[-1] : 0.0F;
#pragma omp simd
    for (int i = 0; i < left; ++i) to[i] = last;
  }
}

// The vertex nearest to a place in the lattice (adding 1.5 * 2^23 rounds).
PENUMBRA_INLINE void store_anchor(const Wide& a, const Wide& b, const Wide& last, int side,
                                  const Samples& s, int i) {
  const Wide va = least(most((a + 12582912.0F) - 12582912.0F, Wide{}), last);
  const Wide vb = least(most((b + 12582912.0F) - 12582912.0F, Wide{}), last);
  store(s.va + i, va);
  store(s.vb + i, vb);
  const WideInts vertex =
      __builtin_convertvector(vb, WideInts) * side + __builtin_convertvector(va, WideInts);
  __builtin_memcpy(s.vertex + i, &vertex, sizeof vertex);
}

template <Lens::Kind kind>
void prepare_as(const Lens& lens_in, const float* M_in, int reach, int side,
                const Samples& samples) {
  // Copies, which the floats that are written are not.
  const Lens lens = lens_in;
  const Samples s = samples;
  float M[9];
  for (int k = 0; k < 9; ++k) M[k] = M_in[k];
  const Wide last = wide(static_cast<float>(side - 1));
  const float anchor_shift = reach == 2 ? 0.5F : 0.0F;
  const float inverse_fx = 1.0F / lens.fx;
  const float inverse_fy = 1.0F / lens.fy;
#pragma GCC unroll 1
  for (int i = 0; i < s.count; i += kWide) {
    const Wide target_x = (load(s.pixel_x + i) - lens.cx) * inverse_fx;
    const Wide target_y = (load(s.pixel_y + i) - lens.cy) * inverse_fy;
    Wide x = target_x;
    Wide y = target_y;
    if constexpr (kind != Lens::Kind::none) {
      // Newton from a guess a few pixels off; the second step, with the first one's derivative,
      // brings it to float precision.
      Wide xd;
      Wide yd;
      Wide j00;
      Wide j01;
      Wide j11;
      Wide inverse_det;
      const auto step = [&] {
        const Wide ex = target_x - xd;
        const Wide ey = target_y - yd;
        x += (j11 * ex - j01 * ey) * inverse_det;
        y += (j00 * ey - j01 * ex) * inverse_det;
      };
      x = load(s.ray_x + i);
      y = load(s.ray_y + i);
      distort<kind>(lens, x, y, xd, yd, j00, j01, j11);
      inverse_det = 1.0F / (j00 * j11 - j01 * j01);
      step();
      if constexpr (kind == Lens::Kind::fisheye) {
        // At its rim rays grow as the tangent of their angle: a step by its own derivative more
        // (0.07 px off without, 75 degrees from the axis and a guess 3 px off).
        distort<kind>(lens, x, y, xd, yd, j00, j01, j11);
        inverse_det = 1.0F / (j00 * j11 - j01 * j01);
        step();
      }
      Wide u00;
      Wide u01;
      Wide u11;
      distort<kind>(lens, x, y, xd, yd, u00, u01, u11);
      step();
    }
    const Wide inverse_s = 1.0F / (M[6] * x + M[7] * y + M[8]);
    const Wide a = (M[0] * x + M[1] * y + M[2]) * inverse_s;
    const Wide b = (M[3] * x + M[4] * y + M[5]) * inverse_s;
    store(s.ray_x + i, x);
    store(s.ray_y + i, y);
    store_anchor(a - anchor_shift, b - anchor_shift, last, side, s, i);
  }
}

void anchor(const float* M_in, int reach, int side, const Samples& samples) {
  const Samples s = samples;  // a copy, which the floats that are written are not
  float M[9];
  for (int k = 0; k < 9; ++k) M[k] = M_in[k];
  const Wide last = wide(static_cast<float>(side - 1));
  const float anchor_shift = reach == 2 ? 0.5F : 0.0F;
#pragma GCC unroll 1
  for (int i = 0; i < s.count; i += kWide) {
    const Wide x = load(s.ray_x + i);
    const Wide y = load(s.ray_y + i);
    const Wide inverse_s = 1.0F / (M[6] * x + M[7] * y + M[8]);
    const Wide a = (M[0] * x + M[1] * y + M[2]) * inverse_s;
    const Wide b = (M[3] * x + M[4] * y + M[5]) * inverse_s;
    store_anchor(a - anchor_shift, b - anchor_shift, last, side, s, i);
  }
}

// What depends on the anchor alone. One record per vertex; four or eight records become as many of
// each.
void attach(const float* ka, const float* kb, const float* coefficients, const Samples& s) {
#if defined(__AVX2__)
  constexpr int kPart = 8;
#else
  constexpr int kPart = 4;
#endif
  using Part = float __attribute__((vector_size(4 * kPart)));
  const std::int32_t* const __restrict vertex = s.vertex;
  float* const __restrict ka_out = s.ka;
  float* const __restrict kb_out = s.kb;
  float* const __restrict c0 = s.c[0];
  float* const __restrict c1 = s.c[1];
  float* const __restrict c2 = s.c[2];
  float* const __restrict c3 = s.c[3];
  for (int i = 0; i < s.count; i += kPart) {
    std::ptrdiff_t v[kPart];
#pragma GCC unroll 8
    for (int k = 0; k < kPart; ++k) v[k] = vertex[i + k];
    const auto record = [&](int k) {
      Floats4 four;
      __builtin_memcpy(&four, coefficients + 4 * v[k], sizeof four);
      return four;
    };
#if defined(__AVX2__)
    const Part part_ka = {ka[v[0]], ka[v[1]], ka[v[2]], ka[v[3]],
                          ka[v[4]], ka[v[5]], ka[v[6]], ka[v[7]]};
    const Part part_kb = {kb[v[0]], kb[v[1]], kb[v[2]], kb[v[3]],
                          kb[v[4]], kb[v[5]], kb[v[6]], kb[v[7]]};
    const auto both = [&](int k) {
      return static_cast<Part>(
          _mm256_set_m128(static_cast<__m128>(record(k + 4)), static_cast<__m128>(record(k))));
    };
    const auto r0 = static_cast<__m256>(both(0));
    const auto r1 = static_cast<__m256>(both(1));
    const auto r2 = static_cast<__m256>(both(2));
    const auto r3 = static_cast<__m256>(both(3));
    const __m256 low01 = _mm256_unpacklo_ps(r0, r1);
    const __m256 low23 = _mm256_unpacklo_ps(r2, r3);
    const __m256 high01 = _mm256_unpackhi_ps(r0, r1);
    const __m256 high23 = _mm256_unpackhi_ps(r2, r3);
    _mm256_storeu_ps(c0 + i, _mm256_shuffle_ps(low01, low23, 0x44));
    _mm256_storeu_ps(c1 + i, _mm256_shuffle_ps(low01, low23, 0xEE));
    _mm256_storeu_ps(c2 + i, _mm256_shuffle_ps(high01, high23, 0x44));
    _mm256_storeu_ps(c3 + i, _mm256_shuffle_ps(high01, high23, 0xEE));
#else
    const Part part_ka = {ka[v[0]], ka[v[1]], ka[v[2]], ka[v[3]]};
    const Part part_kb = {kb[v[0]], kb[v[1]], kb[v[2]], kb[v[3]]};
    Floats4 columns[4] = {record(0), record(1), record(2), record(3)};
    transpose(columns);
    __builtin_memcpy(c0 + i, &columns[0], sizeof(Floats4));
    __builtin_memcpy(c1 + i, &columns[1], sizeof(Floats4));
    __builtin_memcpy(c2 + i, &columns[2], sizeof(Floats4));
    __builtin_memcpy(c3 + i, &columns[3], sizeof(Floats4));
#endif
    __builtin_memcpy(ka_out + i, &part_ka, sizeof part_ka);
    __builtin_memcpy(kb_out + i, &part_kb, sizeof part_kb);
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
PENUMBRA_INLINE Wide pattern(const Wide& a, const Wide& b, const Samples& s, int i, Wide& m_a,
                             Wide& m_b) {
  const float* const* const c = s.c;
  const Wide ka = load(s.ka + i);
  const Wide kb = load(s.kb + i);
  if constexpr (reach == 1) {
    const Wide ua = ka * a;
    const Wide ub = kb * b;
    Wide da;
    Wide db;
    const Wide Fa = normal_cdf(ua, da);
    const Wide Fb = normal_cdf(ub, db);
    const Wide c1 = load(c[1] + i);
    const Wide c2 = load(c[2] + i);
    const Wide c3 = load(c[3] + i);
    if constexpr (correlated) {
      Wide dx;
      Wide dy;
      const Wide Fab = binormal_cdf(ua, ub, load(s.rho + i), Fa, Fb, da, db, dx, dy);
      m_a = ka * (c1 * da + c3 * dx);
      m_b = kb * (c2 * db + c3 * dy);
      return load(c[0] + i) + c1 * Fa + c2 * Fb + c3 * Fab;
    } else {
      const Wide by_b = c2 + c3 * Fa;
      m_a = ka * da * (c1 + c3 * Fb);
      m_b = kb * db * by_b;
      return load(c[0] + i) + c1 * Fa + Fb * by_b;
    }
  } else {
    constexpr float kFirst = reach == 3 ? -1.0F : 0.0F;
    Wide ua[reach];
    Wide ub[reach];
    Wide Fa[reach];
    Wide Fb[reach];
    Wide da[reach];
    Wide db[reach];
    Wide m = load(c[15] + i);
    m_a = Wide{};
    m_b = Wide{};
#pragma GCC unroll 3
    for (int k = 0; k < reach; ++k) {
      ua[k] = ka * (a - (kFirst + static_cast<float>(k)));
      ub[k] = kb * (b - (kFirst + static_cast<float>(k)));
      Fa[k] = normal_cdf(ua[k], da[k]);
      Fb[k] = normal_cdf(ub[k], db[k]);
      const Wide column = load(c[12 + k] + i);
      const Wide row = load(c[4 * k + 3] + i);
      m += column * Fa[k] + row * Fb[k];
      m_a += column * da[k];
      m_b += row * db[k];
    }
#pragma GCC unroll 3
    for (int row = 0; row < reach; ++row) {
#pragma GCC unroll 3
      for (int column = 0; column < reach; ++column) {
        const Wide corner = load(c[4 * row + column] + i);
        if constexpr (correlated) {
          Wide dx;
          Wide dy;
          m += corner * binormal_cdf(ua[column], ub[row], load(s.rho + i), Fa[column], Fb[row],
                                     da[column], db[row], dx, dy);
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

// What a block of samples puts into the sums.
struct BlockTerms {
  alignas(64) float J[7][kBlock];  // and that of the offset, which is 1
  alignas(64) float weight[kBlock];
  alignas(64) float weighted[kBlock];  // residual
};

// The sums, lane by lane: 36 of H, the last of which is the weight, 8 of g, cost, base weight.
struct LaneSums {
  static constexpr int kSums = 46;
  alignas(64) float lanes[kSums][kLanes];
};

// Samples l, l + 16, l + 32 and l + 48 of the block go into lane l.
template <bool first>
__attribute__((noinline)) void add_block(const BlockTerms& block, const float* residuals,
                                         const float* base_weights, LaneSums& sums) {
  constexpr int kQuarters = kBlock / kLanes;
  static_assert(kQuarters == 4, "sums of two and two");
#pragma GCC unroll 1
  for (int l = 0; l < kLanes; l += kWide) {
    int k = 0;
    const auto add = [&](const Wide& x) {
      float* const sum = sums.lanes[k++] + l;
      store(sum, first ? x : load(sum) + x);
    };
    const auto add_product = [&](const Wide* x, const float* y) {
      add((x[0] * load(y) + x[1] * load(y + kLanes)) +
          (x[2] * load(y + 2 * kLanes) + x[3] * load(y + 3 * kLanes)));
    };
    const auto add_sum = [&](const Wide* x) { add((x[0] + x[1]) + (x[2] + x[3])); };
    Wide x[kQuarters];
#pragma GCC unroll 7
    for (int p = 0; p < 7; ++p) {
      // A row's products with the weight stay in registers.
#pragma GCC unroll 4
      for (int n = 0; n < kQuarters; ++n)
        x[n] = load(block.weight + l + n * kLanes) * load(block.J[p] + l + n * kLanes);
#pragma GCC unroll 7
      for (int q = p; q < 7; ++q) add_product(x, block.J[q] + l);
      add_sum(x);
    }
    const auto load_all = [&](const float* at) {
#pragma GCC unroll 4
      for (int n = 0; n < kQuarters; ++n) x[n] = load(at + l + n * kLanes);
    };
    load_all(block.weight);
    add_sum(x);
    load_all(block.weighted);
#pragma GCC unroll 7
    for (int p = 0; p < 7; ++p) add_product(x, block.J[p] + l);
    add_sum(x);
    add_product(x, residuals + l);
    load_all(base_weights);
    add_sum(x);
  }
}

// Four floats as doubles. The compiler's own way to them is twice two.
using Doubles4 = double __attribute__((vector_size(32)));
PENUMBRA_INLINE void load(const float* at, Doubles4& four) {
#if defined(__AVX2__)
  four = _mm256_cvtps_pd(_mm_loadu_ps(at));
#else
  Floats4 floats;
  __builtin_memcpy(&floats, at, sizeof floats);
  four = __builtin_convertvector(floats, Doubles4);
#endif
}

// In double, by halves: with a block or two of samples this is as much work as the samples are.
// `count` is a multiple of 4.
PENUMBRA_INLINE void add_lanes(const float (*lanes)[kLanes], int count, double* sums) {
  static_assert(kLanes == 16, "four halvings");
  using Places = long long __attribute__((vector_size(sizeof(Doubles4))));
#pragma GCC unroll 1
  for (int k = 0; k < count; k += 4) {
    Doubles4 quarters[4];
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) {
      Doubles4 part[4];
#pragma GCC unroll 4
      for (int n = 0; n < 4; ++n) load(lanes[k + i] + 4 * n, part[n]);
      quarters[i] = (part[0] + part[2]) + (part[1] + part[3]);
    }
    const auto halves = [](const Doubles4& x, const Doubles4& y, Doubles4& of_both) {
      of_both =
          __builtin_shuffle(x, y, Places{0, 1, 4, 5}) + __builtin_shuffle(x, y, Places{2, 3, 6, 7});
    };
    Doubles4 even;
    Doubles4 odd;
    halves(quarters[0], quarters[2], even);
    halves(quarters[1], quarters[3], odd);
    const Doubles4 all = __builtin_shuffle(even, odd, Places{0, 4, 2, 6}) +
                         __builtin_shuffle(even, odd, Places{1, 5, 3, 7});
    __builtin_memcpy(sums + k, &all, sizeof all);
  }
}

__attribute__((noinline)) void add_lanes(const LaneSums& from, Sums& sums) {
  double last[4];
  add_lanes(from.lanes, 36, sums.H);
  add_lanes(from.lanes + 36, 8, sums.g);
  add_lanes(from.lanes + 42, 4, last);
  sums.cost = last[2];
  sums.weight = sums.H[35];
  sums.base_weight = last[3];
}

// What a model of `m` leaves of the samples from `i` on, by Tukey's weights.
PENUMBRA_INLINE void weigh(const AccumulateInput& in, const Samples& s, int i, const Wide& m,
                           BlockTerms& block, int l) {
  const Wide r = load(s.value + i) - (in.gain * m + in.offset);
  const Wide t = r * in.inverse_cutoff;
  const Wide inside = most(1.0F - t * t, Wide{});
  const Wide w = load(s.weight + i) * (inside * inside);
  store(block.J[6] + l, m);
  store(block.weight + l, w);
  store(block.weighted + l, w * r);
  store(s.residual + i, r);
}

template <int reach, bool correlated>
void accumulate_as(const AccumulateInput& in, const Samples& samples, Sums& sums) {
  // Copies, which the floats that are written are not.
  const Samples s = samples;
  const AccumulateInput input = in;
  const float* const M = input.lattice_from_ray;
  const float inverse_cz = 1.0F / input.centre[2];
  const float gain = input.gain;
  BlockTerms block;
  LaneSums lanes;
  for (int start = 0; start < s.count; start += kBlock) {
#pragma GCC unroll 1
    for (int l = 0; l < kBlock; l += kWide) {
      const int i = start + l;
      const Wide x = load(s.ray_x + i);
      const Wide y = load(s.ray_y + i);
      const Wide A = M[0] * x + M[1] * y + M[2];
      const Wide B = M[3] * x + M[4] * y + M[5];
      const Wide S = M[6] * x + M[7] * y + M[8];
      const Wide inverse_s = 1.0F / S;
      const Wide a = A * inverse_s;
      const Wide b = B * inverse_s;
      Wide m_a;
      Wide m_b;
      const Wide m =
          pattern<reach, correlated>(a - load(s.va + i), b - load(s.vb + i), s, i, m_a, m_b);
      weigh(input, s, i, m, block, l);
      // A tag that moves by (nu, omega) carries its pattern along; along the fixed ray a changes by
      // -(1, 0, qa, qa b, -qa a, -b) . (nu, omega), and b alike.
      const Wide qa = (a - input.centre[0]) * inverse_cz;
      const Wide qb = (b - input.centre[1]) * inverse_cz;
      const Wide ja = -gain * m_a;
      const Wide jb = -gain * m_b;
      const Wide jz = ja * qa + jb * qb;
      store(block.J[0] + l, ja);
      store(block.J[1] + l, jb);
      store(block.J[2] + l, jz);
      store(block.J[3] + l, jz * b);
      store(block.J[4] + l, -jz * a);
      store(block.J[5] + l, jb * a - ja * b);
    }
    start == 0 ? add_block<true>(block, s.residual, s.weight, lanes)
               : add_block<false>(block, s.residual + start, s.weight + start, lanes);
  }
  if (s.count == 0) lanes = {};
  add_lanes(lanes, sums);
}

// Four doubles side by side: of four tags.
using Pack = double __attribute__((vector_size(32)));
using PackMask = long long __attribute__((vector_size(32)));
PENUMBRA_INLINE void load(const double* at, Pack& pack) {
  __builtin_memcpy(&pack, at, sizeof pack);
}
PENUMBRA_INLINE void store(double* at, const Pack& pack) {
  __builtin_memcpy(at, &pack, sizeof pack);
}

// The rows of R^T A R, for A by rows; where it is symmetric, only the upper triangle.
template <bool symmetric>
PENUMBRA_INLINE void turned(const Pack* A, const Pack* R, const Pack& factor, double (*out)[4]) {
  Pack AR[9];
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j)
      AR[3 * i + j] = A[3 * i] * R[j] + A[3 * i + 1] * R[3 + j] + A[3 * i + 2] * R[6 + j];
  }
  int k = 0;
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
    for (int j = symmetric ? i : 0; j < 3; ++j, ++k)
      store(out[k], factor * (R[i] * AR[j] + R[3 + i] * AR[3 + j] + R[6 + i] * AR[6 + j]));
  }
}

void eliminate(TagPack* packs, int count) {
  for (int n = 0; n < count; ++n) {
    TagPack& pack = packs[n];
    Pack H[36];
    Pack sum = {0.0, 0.0, 0.0, 0.0};
#pragma GCC unroll 36
    for (int k = 0; k < 36; ++k) {
      load(pack.H[k], H[k]);
      sum += H[k];
    }
    const auto at = [](int p, int q) { return p * 8 - p * (p - 1) / 2 + q - p; };
    Pack weight;
    load(pack.weight, weight);
    const Pack& l00 = H[at(6, 6)];
    const Pack& l01 = H[at(6, 7)];
    const Pack& l11 = H[at(7, 7)];
    const Pack det = l00 * l11 - l01 * l01;
    // Finite, seen by enough samples, and of two levels that can be told apart.
    const PackMask valid = (sum - sum == 0.0) & (weight > 8.0) & (det > 1e-6 * (l00 * l11));
    const Pack zero = {0.0, 0.0, 0.0, 0.0};
    const Pack one = {1.0, 1.0, 1.0, 1.0};
#pragma GCC unroll 36
    for (int k = 0; k < 36; ++k) H[k] = valid ? H[k] : zero;
    const Pack inverse_det = 1.0 / (valid ? det : one);
    const Pack i00 = l11 * inverse_det;
    const Pack i01 = -l01 * inverse_det;
    const Pack i11 = l00 * inverse_det;
    store(pack.inverse[0], i00);
    store(pack.inverse[1], i01);
    store(pack.inverse[2], i11);
    Pack g[8];
    for (int p = 0; p < 8; ++p) {
      load(pack.g[p], g[p]);
      g[p] = valid ? g[p] : zero;
    }
    Pack share0[6];
    Pack share1[6];
    Pack g_tag[6];
#pragma GCC unroll 6
    for (int p = 0; p < 6; ++p) {
      const Pack& c0 = H[at(p, 6)];
      const Pack& c1 = H[at(p, 7)];
      share0[p] = c0 * i00 + c1 * i01;
      share1[p] = c0 * i01 + c1 * i11;
      g_tag[p] = g[p] - (share0[p] * g[6] + share1[p] * g[7]);
    }
    Pack P[9];
    Pack Q[9];
    Pack S[9];
#pragma GCC unroll 3
    for (int p = 0; p < 3; ++p) {
#pragma GCC unroll 3
      for (int q = 0; q < 3; ++q) {
        const int low = p < q ? p : q;
        const int high = p < q ? q : p;
        P[3 * p + q] =
            H[at(low, high)] - (share0[low] * H[at(high, 6)] + share1[low] * H[at(high, 7)]);
        Q[3 * p + q] =
            H[at(p, q + 3)] - (share0[p] * H[at(q + 3, 6)] + share1[p] * H[at(q + 3, 7)]);
        S[3 * p + q] = H[at(low + 3, high + 3)] - (share0[low + 3] * H[at(high + 3, 6)] +
                                                   share1[low + 3] * H[at(high + 3, 7)]);
      }
    }
    // Into the camera's frame: the lattice's motion is [R / cell, K R; 0, R] times the camera's,
    // with K = skew(centre). The lever first: Q + P K, then S + Q^T K - K (Q + P K).
    Pack x;
    Pack y;
    Pack z;
    load(pack.centre[0], x);
    load(pack.centre[1], y);
    load(pack.centre[2], z);
    Pack Q_lever[9];
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      Q_lever[3 * i] = Q[3 * i] + (P[3 * i + 1] * z - P[3 * i + 2] * y);
      Q_lever[3 * i + 1] = Q[3 * i + 1] + (P[3 * i + 2] * x - P[3 * i] * z);
      Q_lever[3 * i + 2] = Q[3 * i + 2] + (P[3 * i] * y - P[3 * i + 1] * x);
    }
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      S[3 * i] += Q[3 + i] * z - Q[6 + i] * y;
      S[3 * i + 1] += Q[6 + i] * x - Q[i] * z;
      S[3 * i + 2] += Q[i] * y - Q[3 + i] * x;
    }
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) {
      S[j] -= Q_lever[6 + j] * y - Q_lever[3 + j] * z;
      S[3 + j] -= Q_lever[j] * z - Q_lever[6 + j] * x;
      S[6 + j] -= Q_lever[3 + j] * x - Q_lever[j] * y;
    }
    Pack R[9];
    for (int k = 0; k < 9; ++k) load(pack.R[k], R[k]);
    Pack per_cell;
    load(pack.per_cell, per_cell);
    turned<true>(P, R, per_cell * per_cell, pack.H_camera);
    turned<false>(Q_lever, R, per_cell, pack.H_camera + 6);
    turned<true>(S, R, one, pack.H_camera + 15);
    const Pack turn[3] = {g_tag[3] + (g_tag[1] * z - g_tag[2] * y),
                          g_tag[4] + (g_tag[2] * x - g_tag[0] * z),
                          g_tag[5] + (g_tag[0] * y - g_tag[1] * x)};
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      store(pack.g_camera[i],
            per_cell * (R[i] * g_tag[0] + R[3 + i] * g_tag[1] + R[6 + i] * g_tag[2]));
      store(pack.g_camera[3 + i], R[i] * turn[0] + R[3 + i] * turn[1] + R[6 + i] * turn[2]);
    }
    for (int l = 0; l < 4; ++l) pack.valid[l] = valid[l] != 0;
  }
}

void follow(const CameraStep& step, TagPack* packs, int count) {
  const double inverse_slope = 1.0 / step.slope;
  for (int n = 0; n < count; ++n) {
    TagPack& pack = packs[n];
    Pack R[9];
    for (int k = 0; k < 9; ++k) load(pack.R[k], R[k]);
    Pack centre[3];
    for (int k = 0; k < 3; ++k) load(pack.centre[k], centre[k]);
    Pack per_cell;
    load(pack.per_cell, per_cell);
    const double* xi = step.xi;
    Pack moved[6];
    for (int i = 0; i < 3; ++i) {
      moved[i] = per_cell * (R[3 * i] * xi[0] + R[3 * i + 1] * xi[1] + R[3 * i + 2] * xi[2]);
      moved[3 + i] = R[3 * i] * xi[3] + R[3 * i + 1] * xi[4] + R[3 * i + 2] * xi[5];
    }
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3;
      const int k = (i + 2) % 3;
      moved[i] += centre[j] * moved[3 + k] - centre[k] * moved[3 + j];
    }
    const auto at = [](int p, int q) { return p * 8 - p * (p - 1) / 2 + q - p; };
    Pack left[2];
    for (int c = 0; c < 2; ++c) {
      load(pack.g[6 + c], left[c]);
      left[c] *= inverse_slope;
      for (int p = 0; p < 6; ++p) {
        Pack cross;
        load(pack.H[at(p, 6 + c)], cross);
        left[c] -= cross * moved[p];
      }
    }
    Pack inverse[3];
    for (int k = 0; k < 3; ++k) load(pack.inverse[k], inverse[k]);
    store(pack.levels[0], inverse[0] * left[0] + inverse[1] * left[1]);
    store(pack.levels[1], inverse[1] * left[0] + inverse[2] * left[1]);
    // The tag's corners, one after the other.
    Pack M[9];
    for (int k = 0; k < 9; ++k) load(pack.ray_from_lattice[k], M[k]);
    Pack side;
    load(pack.side_cells, side);
    Pack most = {0.0, 0.0, 0.0, 0.0};
    for (int corner = 0; corner < 4; ++corner) {
      Pack p[3];
      Pack q[3];
      for (int i = 0; i < 3; ++i) {
        p[i] = M[3 * i + 2];
        if ((corner & 1) != 0) p[i] += side * M[3 * i];
        if ((corner & 2) != 0) p[i] += side * M[3 * i + 1];
      }
      for (int i = 0; i < 3; ++i)
        q[i] =
            step.R[3 * i] * p[0] + step.R[3 * i + 1] * p[1] + step.R[3 * i + 2] * p[2] + step.t[i];
      const Pack scale = 1.0 / (q[2] * p[2]);
      const Pack x = (q[0] * p[2] - p[0] * q[2]) * step.fx * scale;
      const Pack y = (q[1] * p[2] - p[1] * q[2]) * step.fy * scale;
      const Pack px2 = x * x + y * y;
      most = ((p[2] > 0.0) & (q[2] > 0.0) & (px2 > most)) ? px2 : most;
    }
    store(pack.moved_px2, most);
  }
}

void levers(const LeverInput& in, const Samples& s) {
  const float inverse_gain = in.inverse_gain;
  const float offset = in.offset;
  const float inverse_limit = in.inverse_limit;
  const int count = s.count;
  const float* const __restrict residual = s.residual;
  const float* const __restrict value = s.value;
  float* const __restrict pairs = s.levers;
  float* const __restrict squares = s.levers + 2 * static_cast<std::ptrdiff_t>(count);
#pragma GCC unroll 1
  for (int i = 0; i < count; i += kWide) {
    const Wide r = load(residual + i) * inverse_gain;
    const Wide m = (load(value + i) - offset) * inverse_gain - r;
    const Wide t = r * inverse_limit;
    const Wide inside = most(1.0F - t * t, Wide{});
    const Wide slope = most(m * (1.0F - m), Wide{});  // of a blurred edge, nearly
    const Wide lever = slope * inside * inside;
    store_pairs(pairs + 2 * static_cast<std::ptrdiff_t>(i), lever * r, lever * slope);
    store(squares + i, lever * lever);
  }
}

template <int reach, bool correlated>
void evaluate_as(const AccumulateInput& in, const Samples& s) {
  const float* M = in.lattice_from_ray;
#pragma GCC unroll 1
  for (int i = 0; i < s.count; i += kWide) {
    const Wide x = load(s.ray_x + i);
    const Wide y = load(s.ray_y + i);
    const Wide inverse_s = 1.0F / (M[6] * x + M[7] * y + M[8]);
    const Wide a = (M[0] * x + M[1] * y + M[2]) * inverse_s;
    const Wide b = (M[3] * x + M[4] * y + M[5]) * inverse_s;
    Wide m_a;
    Wide m_b;
    store(s.model + i,
          pattern<reach, correlated>(a - load(s.va + i), b - load(s.vb + i), s, i, m_a, m_b));
  }
}

template <int reach, bool correlated>
void evaluate_moments_as(const AccumulateInput* inputs, const Samples* moments, int count) {
  const Samples s = moments[0];
  const float share = 1.0F / static_cast<float>(count);
#pragma GCC unroll 1
  for (int i = 0; i < s.count; i += kWide) {
    const Wide x = load(s.ray_x + i);
    const Wide y = load(s.ray_y + i);
    Wide m = {};
#pragma GCC unroll 1
    for (int k = 0; k < count; ++k) {
      const float* const M = inputs[k].lattice_from_ray;
      const Wide inverse_s = 1.0F / (M[6] * x + M[7] * y + M[8]);
      const Wide a = (M[0] * x + M[1] * y + M[2]) * inverse_s;
      const Wide b = (M[3] * x + M[4] * y + M[5]) * inverse_s;
      Wide m_a;
      Wide m_b;
      m += pattern<reach, correlated>(a - load(moments[k].va + i), b - load(moments[k].vb + i),
                                      moments[k], i, m_a, m_b);
    }
    store(s.model + i, m * share);
  }
}

void project(const Lens& lens, const Blur& blur, const float* ray_from_lattice,
             const float* lattice_from_ray, const Vertices& vertices) {
  switch (lens.kind) {
    case Lens::Kind::none:
      project_of<Lens::Kind::none>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
      break;
    case Lens::Kind::polynomial:
      project_of<Lens::Kind::polynomial>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
      break;
    case Lens::Kind::rational:
      project_of<Lens::Kind::rational>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
      break;
    case Lens::Kind::fisheye:
      project_of<Lens::Kind::fisheye>(lens, blur, ray_from_lattice, lattice_from_ray, vertices);
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

void evaluate_moments(const AccumulateInput* inputs, const Samples* moments, int count) {
  const bool correlated = inputs[0].correlated;
  if (inputs[0].reach == 1) {
    correlated ? evaluate_moments_as<1, true>(inputs, moments, count)
               : evaluate_moments_as<1, false>(inputs, moments, count);
  } else if (inputs[0].reach == 2) {
    correlated ? evaluate_moments_as<2, true>(inputs, moments, count)
               : evaluate_moments_as<2, false>(inputs, moments, count);
  } else {
    correlated ? evaluate_moments_as<3, true>(inputs, moments, count)
               : evaluate_moments_as<3, false>(inputs, moments, count);
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

void add(const std::int16_t* scores, int count, std::int32_t* sums) {
#pragma omp simd
  for (int k = 0; k < count; ++k) sums[k] += scores[k];
}

void cell_places(int side, const CellCorners& v, const ImagePlan& image, std::int32_t* places) {
  const float* const __restrict x = v.pixel_x;
  const float* const __restrict y = v.pixel_y;
  const float* const __restrict depth = v.depth;
  std::int32_t* const __restrict out = places;
  const auto stride = static_cast<std::int32_t>(image.stride);
  const float right = static_cast<float>(image.width) - 0.5F;
  const float top = static_cast<float>(image.height) - 0.5F;
  const int count = side * (side - 1) - 1;
#pragma omp simd
  for (int k = 0; k < count; ++k) {
    const float cx = 0.25F * (x[k] + x[k + 1] + x[k + side] + x[k + side + 1]);
    const float cy = 0.25F * (y[k] + y[k + 1] + y[k + side] + y[k + side + 1]);
    const bool seen = (depth[k] > 0.0F) & (depth[k + 1] > 0.0F) & (depth[k + side] > 0.0F) &
                      (depth[k + side + 1] > 0.0F) & (cx >= -0.5F) & (cy >= -0.5F) & (cx < right) &
                      (cy < top);
    // Cut off and rounded up from a half, which is exact as adding a half is not.
    const float least_x = cx > -0.5F ? cx : -0.5F;
    const float least_y = cy > -0.5F ? cy : -0.5F;
    const float safe_x = least_x < right ? least_x : right;
    const float safe_y = least_y < top ? least_y : top;
    const auto cut_x = static_cast<float>(static_cast<std::int32_t>(safe_x));
    const auto cut_y = static_cast<float>(static_cast<std::int32_t>(safe_y));
    const float up_x = safe_x - cut_x >= 0.5F ? 1.0F : 0.0F;
    const float up_y = safe_y - cut_y >= 0.5F ? 1.0F : 0.0F;
    const auto px = static_cast<std::int32_t>(cut_x + up_x);
    const auto py = static_cast<std::int32_t>(cut_y + up_y);
    const std::int32_t place = py * stride + px;
    out[k] = seen ? place : kNowhere;
  }
}

}  // namespace

extern const Variant kVariant;
const Variant kVariant = {PENUMBRA_KERNEL_NAME,
                          project,
                          walk,
                          measure_runs,
                          walk_runs,
                          read,
                          prepare,
                          attach,
                          accumulate,
                          anchor,
                          eliminate,
                          follow,
                          evaluate,
                          evaluate_moments,
                          levers,
                          search,
                          add,
                          cell_places};

#undef PENUMBRA_INLINE

}  // namespace penumbra::kernel::PENUMBRA_KERNEL
