// Vectors of floats with the instruction set's width, and their functions.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

constexpr int kLanes = 16;  // partial sums per quantity, for all instruction sets

// Floats per vector register.
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
// Minimum and maximum; `limit` if x is NaN. Intrinsics, because the compiler turns a constant limit
// into comparisons and blends.
PENUMBRA_INLINE Wide min_of(const Wide& x, const Wide& limit) {
#if defined(__AVX512F__)
  return _mm512_maskz_min_ps(0xFFFF, x, limit);
#elif defined(__AVX2__)
  return _mm256_min_ps(x, limit);
#else
  return x < limit ? x : limit;
#endif
}
PENUMBRA_INLINE Wide max_of(const Wide& x, const Wide& limit) {
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

// Stores x0 y0 x1 y1 ...
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

// exp(-x) for x >= 0 with a relative error below 3e-7: 2^-n by the exponent bits, a polynomial for
// the remainder. The minimum result is about 1e-35.
PENUMBRA_INLINE Wide exp_negative(const Wide& x) {
  const Wide scaled = min_of(x, wide(80.0F)) * -1.44269504F;
  // Adding 1.5 * 2^23 rounds to the nearest integer and stores it in the low bits.
  const Wide shifted = scaled + 12582912.0F;
  const Wide n = shifted - 12582912.0F;
  const Wide f = (scaled - n) * 0.69314718F;  // in [-0.35, 0.35]
  const Wide p =
      1.0F +
      f * (1.0F + f * (0.5F + f * (0.16666667F +
                                   f * (0.04166667F + f * (0.00833333F + f * 0.00138889F)))));
  // Adds n to the exponent; the shift drops the higher bits.
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

// Bivariate normal distribution (Plackett): product plus an integral over theta from 0 to
// asin(rho), by three Gauss-Legendre nodes. d_x, d_y: derivatives.
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
    // sin by its series, for |theta| < 1.26
    const Wide s =
        theta *
        (1.0F + t2 * (-0.16666667F + t2 * (0.00833333F + t2 * (-0.00019841F + t2 * 2.7557e-6F))));
    const Wide inverse = 1.0F / (1.0F - s * s);
    const Wide z = (squares - product * s) * inverse;
    integral += kWeight[k] * exp_negative(max_of(z, Wide{}));
  }
  const Wide root = 1.0F / square_root(1.0F - rho * rho);
  Wide unused;
  d_x = density_x * normal_cdf((y - rho * x) * root, unused);
  d_y = density_y * normal_cdf((x - rho * y) * root, unused);
  return cdf_x * cdf_y + angle * 0.15915494F * integral;
}

using Floats4 = float __attribute__((vector_size(16)));

// Maps rays to lattice points. Copies the matrix, because stores to samples might alias it.
struct LatticeFromRay {
  explicit LatticeFromRay(const float* rows) { __builtin_memcpy(m, rows, sizeof m); }
  PENUMBRA_INLINE void map(const Wide& x, const Wide& y, Wide& a, Wide& b) const {
    const Wide inverse_s = 1.0F / (m[6] * x + m[7] * y + m[8]);
    a = (m[0] * x + m[1] * y + m[2]) * inverse_s;
    b = (m[3] * x + m[4] * y + m[5]) * inverse_s;
  }
  float m[9];
};

// Calls f with run-time values converted to template arguments.
template <class F>
PENUMBRA_INLINE auto with_lens(Lens::Kind kind, const F& f) {
  switch (kind) {
    case Lens::Kind::none:
      return f.template operator()<Lens::Kind::none>();
    case Lens::Kind::polynomial:
      return f.template operator()<Lens::Kind::polynomial>();
    case Lens::Kind::rational:
      return f.template operator()<Lens::Kind::rational>();
    case Lens::Kind::fisheye:
      break;
  }
  return f.template operator()<Lens::Kind::fisheye>();
}
template <class F>
PENUMBRA_INLINE auto with_flags(bool first, bool second, const F& f) {
  if (first)
    return second ? f.template operator()<true, true>() : f.template operator()<true, false>();
  return second ? f.template operator()<false, true>() : f.template operator()<false, false>();
}
template <class F>
PENUMBRA_INLINE void with_reach(int reach, bool correlated, const F& f) {
  const auto with = [&]<int lines>() {
    correlated ? f.template operator()<lines, true>() : f.template operator()<lines, false>();
  };
  if (reach == 1) return with.template operator()<1>();
  if (reach == 2) return with.template operator()<2>();
  with.template operator()<3>();
}
