// Vectors of floats as wide as the instruction set, and the functions of them that the loops use.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

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
