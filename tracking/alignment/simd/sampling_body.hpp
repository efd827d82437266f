// What samples at pixels need beside them: grey levels, rays, the lattice vertex they belong to.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

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
