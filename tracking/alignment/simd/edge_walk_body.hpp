// Walks along the edges of a tag and selects pixels.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

// Floor for |x| < 2^22; may return n - 1 for an integer n.
PENUMBRA_INLINE float round_down(float x) {
  return ((x - 0.5F) + 12582912.0F) - 12582912.0F;
}

constexpr int kSteps = 16;  // steps per block; place: memory offset of a step's first pixel
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
  const auto max_rows = static_cast<float>(w.max_rows);
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
    // Computes the pixel and the edge's direction at that pixel, with the rolling shutter.
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
      rows = all < max_rows ? all : max_rows;
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

// Output arrays of steps.
struct StepOutput {
  float* walk;
  float* cross;
  float* ray_x;
  float* ray_y;
  std::int32_t* place;
  std::int32_t* end;
};

// Writes rows in groups of four, because branches on their number are mispredicted. The next step
// overwrites surplus rows.
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
  std::ptrdiff_t at = used;
  for (int l = 0; l < steps; ++l) {
    const float walk = block.walk[l];
    const float first = block.cross[l];
    const std::int32_t place = block.place[l];
    const Four walk_4 = {walk, walk, walk, walk};
    const Four first_4 = {first, first, first, first};
    const Places place_4 = {place, place, place, place};
    const std::int32_t rows = block.rows[l];
    int i = 0;
    do {
      Four across;
      __builtin_memcpy(&across, offsets + i, sizeof across);
      const Four cross_4 = first_4 + across;
      const Places places_4 = place_4 + __builtin_convertvector(across, Places) * cross_bytes;
      __builtin_memcpy(walk_out + at + i, &walk_4, sizeof walk_4);
      __builtin_memcpy(cross_out + at + i, &cross_4, sizeof cross_4);
      __builtin_memcpy(place_out + at + i, &places_4, sizeof places_4);
      if constexpr (with_rays) {
        const float x = block.ray_x[l];
        const float y = block.ray_y[l];
        const Four x_4 = {x, x, x, x};
        const Four y_4 = {y, y, y, y};
        __builtin_memcpy(x_out + at + i, &x_4, sizeof x_4);
        __builtin_memcpy(y_out + at + i, &y_4, sizeof y_4);
      }
      i += 4;
    } while (!one_group && i < rows);
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
    used = w.max_rows <= 4
               ? write_steps<kRays, true>(block, steps, w.offsets, cross_bytes, out, used)
               : write_steps<kRays, false>(block, steps, w.offsets, cross_bytes, out, used);
    out.end += kSteps;
  }
  return used;
}

int walk(const Lens& lens, const Walk& w, const Samples& s, int used) {
  return with_lens(lens.kind, [&]<Lens::Kind kind>() {
    return with_flags(w.along_x, w.band_count > 0, [&]<bool along_x, bool band>() {
      return walk_as<kind, along_x, band>(lens, w, s, used);
    });
  });
}

// Uses double precision, because floats at the far end of a run may round to another pixel.
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

// Steps along runs with the same walk axis, each with the data of its run.
struct RunSteps {
  static constexpr int kRoom = kSteps + 4;  // steps are written in groups of four
  alignas(64) double at[kRoom], along[kRoom], across[kRoom], direction[kRoom], slope[kRoom];
  alignas(64) double reach[kRoom], ray_x[kRoom], ray_y[kRoom], per_px_x[kRoom], per_px_y[kRoom];
};

// Floor for |x| < 2^20.
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
  const std::int32_t max_rows = w.max_rows;
  const std::int32_t band_rows = w.band_count;
#pragma omp simd
  for (int i = 0; i < kSteps; ++i) {
    const std::int32_t walk =
        floor_of_double(steps.along[i] + steps.direction[i] * steps.at[i] + 0.5);
    // Distance of this pixel's centre from the begin of the run, along the walk.
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
      const std::int32_t some = all < max_rows ? all : max_rows;
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
  // Runs that end in a block: index, and number of the block's steps before the end (>= 1).
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
      used = w.max_rows <= 4
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
  return with_flags(
      w.band_count > 0, lens.kind != Lens::Kind::none,
      [&]<bool band, bool with_rays>() { return walk_runs_as<band, with_rays>(w, s); });
}
