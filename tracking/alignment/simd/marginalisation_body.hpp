// Marginalises gains and offsets (Schur complement), and applies a step to the tags.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

// Four doubles, one for each of four tags.
using Pack = double __attribute__((vector_size(32)));
using PackMask = long long __attribute__((vector_size(32)));
PENUMBRA_INLINE void load(const double* at, Pack& pack) {
  __builtin_memcpy(&pack, at, sizeof pack);
}
template <int count>
PENUMBRA_INLINE void load(const double (*at)[4], Pack (&packs)[count]) {
#pragma GCC unroll 36
  for (int k = 0; k < count; ++k) load(at[k], packs[k]);
}
PENUMBRA_INLINE void store(double* at, const Pack& pack) {
  __builtin_memcpy(at, &pack, sizeof pack);
}

// Returns the index into the upper triangle of H; p <= q. 0 to 5: motion; 6: gain; 7: offset.
constexpr int upper(int p, int q) {
  return p * 8 - p * (p - 1) / 2 + q - p;
}

// Writes factor R^T A R in row order; for a symmetric A only the upper triangle.
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

void marginalise(TagPack* packs, int count) {
  for (int n = 0; n < count; ++n) {
    TagPack& pack = packs[n];
    Pack H[36];
    load(pack.H, H);
    Pack sum = {0.0, 0.0, 0.0, 0.0};
#pragma GCC unroll 36
    for (int k = 0; k < 36; ++k) sum += H[k];
    Pack weight;
    load(pack.weight, weight);
    const Pack& l00 = H[upper(6, 6)];
    const Pack& l01 = H[upper(6, 7)];
    const Pack& l11 = H[upper(7, 7)];
    const Pack det = l00 * l11 - l01 * l01;
    // Valid tags have finite sums, enough samples and samples of two distinct levels.
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
    load(pack.g, g);
    for (int p = 0; p < 8; ++p) g[p] = valid ? g[p] : zero;
    Pack share0[6];
    Pack share1[6];
    Pack g_tag[6];
#pragma GCC unroll 6
    for (int p = 0; p < 6; ++p) {
      const Pack& c0 = H[upper(p, 6)];
      const Pack& c1 = H[upper(p, 7)];
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
        P[3 * p + q] = H[upper(low, high)] -
                       (share0[low] * H[upper(high, 6)] + share1[low] * H[upper(high, 7)]);
        Q[3 * p + q] =
            H[upper(p, q + 3)] - (share0[p] * H[upper(q + 3, 6)] + share1[p] * H[upper(q + 3, 7)]);
        S[3 * p + q] = H[upper(low + 3, high + 3)] - (share0[low + 3] * H[upper(high + 3, 6)] +
                                                      share1[low + 3] * H[upper(high + 3, 7)]);
      }
    }
    // [R / cell, K R; 0, R], K = skew(centre), maps camera motion to the lattice. Transforms the
    // marginalised [P, Q; Q^T, S]: adds P K to Q, Q^T K - K (Q + P K) to S, then rotates.
    Pack centre[3];
    load(pack.centre, centre);
    const Pack& x = centre[0];
    const Pack& y = centre[1];
    const Pack& z = centre[2];
    Pack Q_turned[9];
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      Q_turned[3 * i] = Q[3 * i] + (P[3 * i + 1] * z - P[3 * i + 2] * y);
      Q_turned[3 * i + 1] = Q[3 * i + 1] + (P[3 * i + 2] * x - P[3 * i] * z);
      Q_turned[3 * i + 2] = Q[3 * i + 2] + (P[3 * i] * y - P[3 * i + 1] * x);
    }
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      S[3 * i] += Q[3 + i] * z - Q[6 + i] * y;
      S[3 * i + 1] += Q[6 + i] * x - Q[i] * z;
      S[3 * i + 2] += Q[i] * y - Q[3 + i] * x;
    }
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) {
      S[j] -= Q_turned[6 + j] * y - Q_turned[3 + j] * z;
      S[3 + j] -= Q_turned[j] * z - Q_turned[6 + j] * x;
      S[6 + j] -= Q_turned[3 + j] * x - Q_turned[j] * y;
    }
    Pack R[9];
    load(pack.R, R);
    Pack per_cell;
    load(pack.per_cell, per_cell);
    turned<true>(P, R, per_cell * per_cell, pack.H_camera);
    turned<false>(Q_turned, R, per_cell, pack.H_camera + 6);
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
    load(pack.R, R);
    Pack centre[3];
    load(pack.centre, centre);
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
    Pack level_gradient[2];
    for (int c = 0; c < 2; ++c) {
      load(pack.g[6 + c], level_gradient[c]);
      level_gradient[c] *= inverse_slope;
      for (int p = 0; p < 6; ++p) {
        Pack cross;
        load(pack.H[upper(p, 6 + c)], cross);
        level_gradient[c] -= cross * moved[p];
      }
    }
    Pack inverse[3];
    load(pack.inverse, inverse);
    store(pack.levels[0], inverse[0] * level_gradient[0] + inverse[1] * level_gradient[1]);
    store(pack.levels[1], inverse[1] * level_gradient[0] + inverse[2] * level_gradient[1]);
    // Finds the maximum motion of the tag's corners.
    Pack M[9];
    load(pack.ray_from_lattice, M);
    Pack side;
    load(pack.side_cells, side);
    Pack max_px2 = {0.0, 0.0, 0.0, 0.0};
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
      max_px2 = ((p[2] > 0.0) & (q[2] > 0.0) & (px2 > max_px2)) ? px2 : max_px2;
    }
    store(pack.moved_px2, max_px2);
  }
}
