// Projects lattice points and their blur with the lens model, and finds pixels of cells. Included
// by loops_body.hpp, once for each instruction set, inside its namespace.

// Value: float or Wide.
template <class Value>
PENUMBRA_INLINE Value arc_tangent(const Value& r) {  // r >= 0; Abramowitz and Stegun 4.4.49
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
  } else if constexpr (kind == Lens::Kind::polynomial || kind == Lens::Kind::rational) {
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
    static_assert(kind == Lens::Kind::fisheye, "a lens without a formula");
    const Value min_r2 = Value{} + 1e-8F;
    const Value r2_safe = r2 > min_r2 ? r2 : min_r2;
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

// Requested outputs for vertices.
enum class Wanted {
  places,          // pixel and depth
  spread,          // also ray and blur, for motion along an image axis
  oblique_spread,  // also ray and blur, for motion in any direction
  correlation,     // also the correlation of the blur along a and b
};

template <Lens::Kind kind, Wanted wanted>
void project_as(const Lens& lens_in, const Blur& blur, const float* M_in, const float* N_in,
                const Vertices& v_in) {
  // Copies: stores to the arrays can't change them.
  const Lens lens = lens_in;
  const Vertices v = v_in;
  float M[9];
  float N[9];
  __builtin_memcpy(M, M_in, sizeof M);
  __builtin_memcpy(N, N_in, sizeof N);
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
    const Wide inverse = 1.0F / max_of(Z, wide(1e-9F));
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
    // d(a, b) / d ray, then d(a, b) / d pixel
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
    constexpr bool kOblique = wanted != Wanted::spread;
    Wide var_a = au * au * cxx;
    Wide var_b = bu * bu * cxx;
    if constexpr (kOblique) {
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
      store(v.rho + i, max_of(min_of(cov * ka * kb, wide(0.95F)), wide(-0.95F)));
    }
  }
}

void project(const Lens& lens, const Blur& blur, const float* M, const float* N,
             const Vertices& v) {
  with_lens(lens.kind, [&]<Lens::Kind kind>() {
    if (v.ka == nullptr) {
      project_as<kind, Wanted::places>(lens, blur, M, N, v);
    } else if (v.rho != nullptr) {
      project_as<kind, Wanted::correlation>(lens, blur, M, N, v);
    } else if (blur.motion_x_px * blur.motion_y_px != 0.0F) {
      project_as<kind, Wanted::oblique_spread>(lens, blur, M, N, v);
    } else {
      project_as<kind, Wanted::spread>(lens, blur, M, N, v);
    }
  });
}

void cell_pixels(int side, const CellCorners& v, const ImagePlan& image, std::int32_t* places) {
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
    // Rounds half up by truncation; adding 0.5 would not be exact.
    const float bounded_x = cx > -0.5F ? cx : -0.5F;
    const float bounded_y = cy > -0.5F ? cy : -0.5F;
    const float safe_x = bounded_x < right ? bounded_x : right;
    const float safe_y = bounded_y < top ? bounded_y : top;
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
