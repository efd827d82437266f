// Reads grey levels of samples and computes their rays and anchors (see alignment_loops.hpp).
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

void read(const std::uint8_t* pixels, const float* levels, int used, const Samples& s) {
  const std::int32_t* const __restrict offset = s.vertex;
  float* const __restrict value = s.value;
#pragma GCC unroll 4
  for (int i = 0; i < used; ++i) value[i] = levels[pixels[offset[i]]];
  float* const __restrict weight = s.weight;
#pragma omp simd
  for (int i = 0; i < used; ++i) weight[i] = 1.0F;
  const int padding = s.count - used;
  if (padding == 0) return;
  float* const arrays[] = {s.pixel_x, s.pixel_y, s.ray_x, s.ray_y, s.value, s.weight};
#pragma GCC unroll 6
  for (int k = 0; k < 6; ++k) {
    float* const __restrict to = arrays[k] + used;
    const float last = k < 4 && used > 0 ? to[-1] : 0.0F;
#pragma omp simd
    for (int i = 0; i < padding; ++i) to[i] = last;
  }
}

// Stores the vertex nearest to a lattice point; adding 1.5 * 2^23 rounds to an integer.
PENUMBRA_INLINE void store_anchor(const Wide& a, const Wide& b, const Wide& last, int side,
                                  const Samples& s, int i) {
  const Wide va = min_of(max_of((a + 12582912.0F) - 12582912.0F, Wide{}), last);
  const Wide vb = min_of(max_of((b + 12582912.0F) - 12582912.0F, Wide{}), last);
  store(s.va + i, va);
  store(s.vb + i, vb);
  const WideInts vertex =
      __builtin_convertvector(vb, WideInts) * side + __builtin_convertvector(va, WideInts);
  __builtin_memcpy(s.vertex + i, &vertex, sizeof vertex);
}

template <Lens::Kind kind>
void prepare_as(const Lens& lens_in, const float* M_in, int reach, int side,
                const Samples& samples) {
  // Copies: stores to the arrays can't change them.
  const Lens lens = lens_in;
  const Samples s = samples;
  const LatticeFromRay M(M_in);
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
      // Newton's method: a second step with the same derivative reaches float precision.
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
        // Needs a third step, because ray coordinates grow like the tangent of the angle (0.07 px
        // error without it at 75 degrees).
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
    Wide a;
    Wide b;
    M.map(x, y, a, b);
    store(s.ray_x + i, x);
    store(s.ray_y + i, y);
    store_anchor(a - anchor_shift, b - anchor_shift, last, side, s, i);
  }
}

void anchor(const float* M_in, int reach, int side, const Samples& samples) {
  const Samples s = samples;  // a copy: stores to the arrays can't change it
  const LatticeFromRay M(M_in);
  const Wide last = wide(static_cast<float>(side - 1));
  const float anchor_shift = reach == 2 ? 0.5F : 0.0F;
#pragma GCC unroll 1
  for (int i = 0; i < s.count; i += kWide) {
    Wide a;
    Wide b;
    M.map(load(s.ray_x + i), load(s.ray_y + i), a, b);
    store_anchor(a - anchor_shift, b - anchor_shift, last, side, s, i);
  }
}

void flatten(const CurvedPaper& paper, int reach, int side, const Samples& samples) {
  // Copies: stores to the arrays can't change them.
  const Samples s = samples;
  const LatticeFromRay lattice(paper.lattice_from_ray);
  const LatticeFromRay ray(paper.ray_from_lattice);  // the same mapping with the inverse matrix
  const Wide last = wide(static_cast<float>(side - 1));
  const float anchor_shift = reach == 2 ? 0.5F : 0.0F;
  const float half = paper.half;
  const float c0 = paper.height[0];
  const float c1 = 0.5F * paper.height[1];
  const float c2 = paper.height[2];
  const float c3 = 0.5F * paper.height[3];
  const float camera_a = paper.camera[0];
  const float camera_b = paper.camera[1];
  const float inverse_cz = 1.0F / paper.camera[2];
#pragma GCC unroll 1
  for (int i = 0; i < s.count; i += kWide) {
    Wide a;
    Wide b;
    lattice.map(load(s.ray_x + i), load(s.ray_y + i), a, b);
    const Wide da = a - half;
    const Wide db = b - half;
    const Wide share = (c0 + da * (c1 * da + c2 * db) + c3 * db * db) * inverse_cz;
    a -= (a - camera_a) * share;
    b -= (b - camera_b) * share;
    Wide x;
    Wide y;
    ray.map(a, b, x, y);
    store(s.ray_x + i, x);
    store(s.ray_y + i, y);
    store_anchor(a - anchor_shift, b - anchor_shift, last, side, s, i);
  }
}

// Gathers ka, kb and the coefficients of each anchor; transposes the coefficients into four arrays.
void attach(const float* ka, const float* kb, const float* coefficients, const Samples& s) {
#if defined(__AVX2__)
  constexpr int kPart = 8;
#else
  constexpr int kPart = 4;
#endif
  using Part = float __attribute__((vector_size(4 * kPart)));
  using Places = std::int32_t __attribute__((vector_size(4 * kPart)));
#if defined(__AVX2__)
  constexpr Places kLow = {0, 8, 1, 9, 4, 12, 5, 13};
  constexpr Places kHigh = {2, 10, 3, 11, 6, 14, 7, 15};
  constexpr Places kEven = {0, 1, 8, 9, 4, 5, 12, 13};
  constexpr Places kOdd = {2, 3, 10, 11, 6, 7, 14, 15};
#else
  constexpr Places kLow = {0, 4, 1, 5};
  constexpr Places kHigh = {2, 6, 3, 7};
  constexpr Places kEven = {0, 1, 4, 5};
  constexpr Places kOdd = {2, 3, 6, 7};
#endif
  const std::int32_t* const __restrict vertex = s.vertex;
  for (int i = 0; i < s.count; i += kPart) {
    std::ptrdiff_t v[kPart];
    Part part_ka{};
    Part part_kb{};
#pragma GCC unroll 8
    for (int k = 0; k < kPart; ++k) {
      v[k] = vertex[i + k];
      part_ka[k] = ka[v[k]];
      part_kb[k] = kb[v[k]];
    }
    const auto record = [&](int k) {
      Floats4 four;
      __builtin_memcpy(&four, coefficients + 4 * v[k], sizeof four);
      return four;
    };
    const auto row = [&](int k) {
#if defined(__AVX2__)
      return __builtin_shufflevector(record(k), record(k + 4), 0, 1, 2, 3, 4, 5, 6, 7);
#else
      return record(k);
#endif
    };
    const Part r[4] = {row(0), row(1), row(2), row(3)};
    const Part low01 = __builtin_shuffle(r[0], r[1], kLow);
    const Part low23 = __builtin_shuffle(r[2], r[3], kLow);
    const Part high01 = __builtin_shuffle(r[0], r[1], kHigh);
    const Part high23 = __builtin_shuffle(r[2], r[3], kHigh);
    const Part parts[] = {part_ka,
                          part_kb,
                          __builtin_shuffle(low01, low23, kEven),
                          __builtin_shuffle(low01, low23, kOdd),
                          __builtin_shuffle(high01, high23, kEven),
                          __builtin_shuffle(high01, high23, kOdd)};
    float* const arrays[] = {s.ka, s.kb, s.c[0], s.c[1], s.c[2], s.c[3]};
#pragma GCC unroll 6
    for (int k = 0; k < 6; ++k) __builtin_memcpy(arrays[k] + i, &parts[k], sizeof(Part));
  }
}

void prepare(const Lens& lens, const float* lattice_from_ray, int reach, int side,
             const Samples& samples) {
  with_lens(lens.kind, [&]<Lens::Kind kind>() {
    prepare_as<kind>(lens, lattice_from_ray, reach, side, samples);
  });
}
