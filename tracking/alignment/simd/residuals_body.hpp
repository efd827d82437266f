// Evaluates the blurred pattern at samples, residuals and the normal equations of one tag.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

// Returns the blurred pattern at (a, b) relative to the anchor, and its derivatives by a and b.
//
// One line per axis: with F the normal distributions of the distances to the vertex's two lines,
//   m = c0 + c1 Fa + c2 Fb + c3 F(a and b).
// Two or three lines per axis (0, 1 or -1, 0, 1 from the anchor): c[15] is the colour below and
// left of all lines, c[12 + i] its change at column line i, c[4 * j + 3] its change at row line j,
// and c[4 * j + i] the second difference of the colours at the vertex of both lines.
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

// Terms of a block of samples.
struct BlockTerms {
  alignas(64) float J[7][kBlock];  // without the column of the offset, which is 1
  alignas(64) float weight[kBlock];
  alignas(64) float weighted[kBlock];  // weight * residual
};

// Sums per lane: 36 of H (the final one is the weight), 8 of g, cost, base weight.
struct LaneSums {
  static constexpr int kSums = 46;
  alignas(64) float lanes[kSums][kLanes];
};

// Adds samples l, l + 16, l + 32 and l + 48 of the block to lane l.
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
      // Keeps a row's products with the weight in registers.
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

// Converts four floats to doubles; the compiler's conversion handles only two at a time.
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

// Sums the lanes in double precision by repeated halving. `count` must be a multiple of 4.
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

// Computes residuals and Tukey's weights of the samples from index `i` for the model value `m`.
PENUMBRA_INLINE void weigh(const AccumulateInput& in, const Samples& s, int i, const Wide& m,
                           BlockTerms& block, int l) {
  const Wide r = load(s.value + i) - (in.gain * m + in.offset);
  const Wide t = r * in.inverse_cutoff;
  const Wide inside = max_of(1.0F - t * t, Wide{});
  const Wide w = load(s.weight + i) * (inside * inside);
  store(block.J[6] + l, m);
  store(block.weight + l, w);
  store(block.weighted + l, w * r);
  store(s.residual + i, r);
}

template <int reach, bool correlated>
void accumulate_as(const AccumulateInput& in, const Samples& samples, Sums& sums) {
  // Copies: stores to the arrays can't change them.
  const Samples s = samples;
  const AccumulateInput input = in;
  const LatticeFromRay M(in.lattice_from_ray);
  const float inverse_cz = 1.0F / input.centre[2];
  const float gain = input.gain;
  BlockTerms block;
  LaneSums lanes;
  for (int start = 0; start < s.count; start += kBlock) {
#pragma GCC unroll 1
    for (int l = 0; l < kBlock; l += kWide) {
      const int i = start + l;
      Wide a;
      Wide b;
      M.map(load(s.ray_x + i), load(s.ray_y + i), a, b);
      Wide m_a;
      Wide m_b;
      const Wide m =
          pattern<reach, correlated>(a - load(s.va + i), b - load(s.vb + i), s, i, m_a, m_b);
      weigh(input, s, i, m, block, l);
      // The pattern moves with the tag. On a fixed ray, a changes by
      // -(1, 0, qa, qa b, -qa a, -b) . (nu, omega), and b correspondingly.
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

void leverage(const LeverageInput& in, const Samples& s) {
  const float inverse_gain = in.inverse_gain;
  const float offset = in.offset;
  const float inverse_limit = in.inverse_limit;
  const int count = s.count;
  const float* const __restrict residual = s.residual;
  const float* const __restrict value = s.value;
  float* const __restrict pairs = s.leverage;
  float* const __restrict squares = s.leverage + 2 * static_cast<std::ptrdiff_t>(count);
#pragma GCC unroll 1
  for (int i = 0; i < count; i += kWide) {
    const Wide r = load(residual + i) * inverse_gain;
    const Wide m = (load(value + i) - offset) * inverse_gain - r;
    const Wide t = r * inverse_limit;
    const Wide inside = max_of(1.0F - t * t, Wide{});
    const Wide slope = max_of(m * (1.0F - m), Wide{});  // approximate slope of a blurred edge
    const Wide effect = slope * inside * inside;
    store_pairs(pairs + 2 * static_cast<std::ptrdiff_t>(i), effect * r, effect * slope);
    store(squares + i, effect * effect);
  }
}

template <int reach, bool correlated>
void evaluate_as(const AccumulateInput* inputs, const Samples* moments, int count) {
  const Samples s = moments[0];
  const float share = 1.0F / static_cast<float>(count);
#pragma GCC unroll 1
  for (int i = 0; i < s.count; i += kWide) {
    const Wide x = load(s.ray_x + i);
    const Wide y = load(s.ray_y + i);
    Wide m = {};
#pragma GCC unroll 1
    for (int k = 0; k < count; ++k) {
      Wide a;
      Wide b;
      LatticeFromRay(inputs[k].lattice_from_ray).map(x, y, a, b);
      Wide m_a;
      Wide m_b;
      m += pattern<reach, correlated>(a - load(moments[k].va + i), b - load(moments[k].vb + i),
                                      moments[k], i, m_a, m_b);
    }
    store(s.model + i, m * share);
  }
}

void accumulate(const AccumulateInput& in, const Samples& samples, Sums& sums) {
  with_reach(in.reach, in.correlated, [&]<int reach, bool correlated>() {
    accumulate_as<reach, correlated>(in, samples, sums);
  });
}

void evaluate(const AccumulateInput* inputs, const Samples* moments, int count) {
  with_reach(inputs[0].reach, inputs[0].correlated, [&]<int reach, bool correlated>() {
    evaluate_as<reach, correlated>(inputs, moments, count);
  });
}
