// Which pixels an alignment looks at, and what it needs to know about each.

#include "tracking/tag_alignment_state.hpp"

#include <algorithm>
#include <cstring>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Of the edges along one of the lattice's directions.
template <class Tag>
int edge_cells(const Tag& tag, std::size_t direction) {
  const auto& cells = tag.edge_cells[direction];
  return cells.empty() ? 0 : static_cast<int>(cells.size()) - 1;
}

// Pixels at a step across an edge.
template <class Band>
int rows_at_most(const Band& band, double reach_px) {
  return band.count > 0 ? band.count : std::min(static_cast<int>(3.0 * reach_px) + 2, 17);
}

// From step to step along edges that are so long altogether, for about `cap` samples [px].
template <class Band>
double stride_of(const Band& band, double reach_px, double length, double tilt, int cap) {
  const double steepness = std::sqrt(1.0 + (tilt / length) * (tilt / length));
  const double rows = band.count > 0 ? band.count : std::min(2.0 * reach_px * steepness, 16.0);
  return std::max(1.0, length * rows / cap);
}

// Four floats side by side.
using Four = float __attribute__((vector_size(16)));
Four all_four(float value) {
  return Four{value, value, value, value};
}
Four load(const float* at) {
  Four four;
  std::memcpy(&four, at, sizeof four);
  return four;
}
void store(float* at, Four four) {
  std::memcpy(at, &four, sizeof four);
}

}  // namespace

// Gain and offset of each tag from its data cells, so that nothing is carried over from another
// exposure.
void TagAligner::Impl::read_levels() {
  for (Tag* tag : active) {
    double white = 0.0;
    double black = 0.0;
    int whites = 0;
    int blacks = 0;
    for (const DataCell& cell : tag->pattern.data_cells()) {
      int px = 0;
      int py = 0;
      if (!nearest_cell_pixel(*tag, cell, px, py)) continue;
      const double value = static_cast<double>(tone[image.row(py)[px]]);
      (cell.white ? white : black) += value;
      ++(cell.white ? whites : blacks);
    }
    if (whites < 2 || blacks < 2) {
      tag->gain = 0.0;
      continue;
    }
    tag->offset = black / blacks;
    tag->gain = white / whites - tag->offset;
  }
}

// Where the samples' pixels lie in the image's memory, for finish_samples.
void TagAligner::Impl::locate_samples(Tag& tag) const {
  const kernel::Samples& s = tag.samples;
  const auto stride = static_cast<std::int32_t>(image.stride);
  for (int i = 0; i < tag.used; ++i)
    s.vertex[i] =
        static_cast<std::int32_t>(s.pixel_y[i]) * stride + static_cast<std::int32_t>(s.pixel_x[i]);
}

// Fills in what the kernel needs beside pixels, their places in memory (in `vertex`) and guesses of
// their rays.
void TagAligner::Impl::finish_samples(Tag& tag) {
  tag.samples.count = (tag.used + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
  const kernel::Samples s = tag.samples;  // a copy, which the floats that are written are not
  const int used = tag.used;
  const int padded = s.count;
  const std::uint8_t* const pixels = image.data;
  const float* const levels = tone.data();
  for (int i = 0; i < used; ++i) s.value[i] = levels[pixels[s.vertex[i]]];
  std::fill(s.weight, s.weight + used, 1.0F);
  if (!tag.row_shear.isZero()) {
    // From here on the samples are where they would be, had their rows been read out with the
    // tag's.
    const auto row = static_cast<float>(tag.row);
    const Eigen::Vector2f shear = tag.row_shear.cast<float>();
    for (int i = 0; i < used; ++i) {
      const float rows = s.pixel_y[i] - row;
      s.pixel_x[i] -= shear.x() * rows;
      s.pixel_y[i] -= shear.y() * rows;
    }
  }
  for (float* array : {s.pixel_x, s.pixel_y, s.ray_x, s.ray_y})
    std::fill(array + used, array + padded, used > 0 ? array[used - 1] : 0.0F);
  std::fill(s.value + used, s.value + padded, 0.0F);
  std::fill(s.weight + used, s.weight + padded, 0.0F);
  kernel->prepare(lens, tag.lattice_from_ray.data(), tag.reach, tag.side, s);
  // What depends on the anchor alone. One record per vertex; gathering it here is faster than by
  // vector instructions.
  if (tag.reach == 1) {
    const float* const ka = tag.ka.data();
    const float* const kb = tag.kb.data();
    const std::array<float, 4>* const coefficients = tag.coefficients1.data();
    if (tag.correlated) {
      for (int i = 0; i < padded; ++i) s.rho[i] = tag.rho[static_cast<std::size_t>(s.vertex[i])];
    }
    // Four records of four become four of each.
    for (int i = 0; i < padded; i += 4) {
      const auto record = [&](int k) {
        const std::int32_t v = s.vertex[i + k];
        s.ka[i + k] = ka[v];
        s.kb[i + k] = kb[v];
        return load(coefficients[v].data());
      };
      const Four r0 = record(0);
      const Four r1 = record(1);
      const Four r2 = record(2);
      const Four r3 = record(3);
      using Places = std::int32_t __attribute__((vector_size(16)));
      const Four low01 = __builtin_shuffle(r0, r1, Places{0, 4, 1, 5});
      const Four low23 = __builtin_shuffle(r2, r3, Places{0, 4, 1, 5});
      const Four high01 = __builtin_shuffle(r0, r1, Places{2, 6, 3, 7});
      const Four high23 = __builtin_shuffle(r2, r3, Places{2, 6, 3, 7});
      store(s.c[0] + i, __builtin_shuffle(low01, low23, Places{0, 1, 4, 5}));
      store(s.c[1] + i, __builtin_shuffle(low01, low23, Places{2, 3, 6, 7}));
      store(s.c[2] + i, __builtin_shuffle(high01, high23, Places{0, 1, 4, 5}));
      store(s.c[3] + i, __builtin_shuffle(high01, high23, Places{2, 3, 6, 7}));
    }
    return;
  }
  const std::vector<std::array<float, 16>>& table =
      tag.reach == 2 ? tag.coefficients2 : tag.coefficients3;
  for (int i = 0; i < padded; ++i) {
    const auto v = static_cast<std::size_t>(s.vertex[i]);
    const std::array<float, 16>& c = table[v];
    s.ka[i] = tag.ka[v];
    s.kb[i] = tag.kb[v];
    s.rho[i] = tag.rho[v];
    for (const std::size_t k : {0U, 1U, 3U, 4U, 5U, 7U, 12U, 13U, 15U}) s.c[k][i] = c[k];
    if (tag.reach == 3) {
      for (const std::size_t k : {2U, 6U, 8U, 9U, 10U, 11U, 14U}) s.c[k][i] = c[k];
    }
  }
}

void TagAligner::Impl::take_samples(Tag& tag, int capacity) {
  tag.capacity = capacity;
  tag.samples = arena.take(capacity, tag.reach);
  // The kernels write whole blocks.
  if (const auto most = static_cast<std::size_t>(capacity + kernel::kBlock);
      tag.vertex.size() < most)
    tag.vertex.resize(most + most / 2);
  tag.samples.vertex = tag.vertex.data();
}

// Chooses the pixels at the edges, up to about `cap`.
void TagAligner::Impl::select(Tag& tag, bool wide, int cap) {
  tag.used = 0;
  tag.step_count = 0;
  const double sigma =
      std::sqrt(options.blur_px * options.blur_px + tag.motion_px.squaredNorm() / 12.0);
  Band band;
  if (wide) {
    // Far enough out to feel an edge half a cell away.
    const double unit = std::max(tag.cell_px / 10.0, 0.3);
    for (const double o : {-5.0, -3.0, -1.0, 1.0, 3.0, 5.0})
      band.offsets[static_cast<std::size_t>(band.count++)] = floor_of(o * unit + 0.5);
  }
  // Within 2.1 sigma of an edge lies all but a two-hundredth of what it tells; a limited number of
  // pixels is best spent closer.
  const double reach_px = (options.effort == AlignmentEffort::accurate ? 2.1 : 1.25) * sigma;
  // Of steps nearer than this two may fall on a pixel where the tag is seen smaller.
  constexpr double kLeastStep_px = 1.5;
  // The tilt of a lone tag hangs on single edges.
  constexpr std::size_t kFewestTags = 3;
  if (options.lattice_steps && active.size() >= kFewestTags) {
    // Lengths by the cells at the tag's centre: of each direction's edges along the image axis they
    // are nearer to, and along the other one.
    double length = 0.0;
    double tilt = 0.0;
    for (const auto& [direction, cell_px] :
         {std::pair(0U, tag.along_a), std::pair(1U, tag.along_b)}) {
      const double cells = edge_cells(tag, direction);
      length += cells * cell_px.cwiseAbs().maxCoeff();
      tilt += cells * cell_px.cwiseAbs().minCoeff();
    }
    const double stride = stride_of(band, reach_px, length, tilt, cap);
    if (stride > kLeastStep_px && length < 1e7) {
      step_along(tag, band, reach_px, stride);
      PENUMBRA_ASSERT(tag.used <= tag.capacity);
      finish_samples(tag);
      return;
    }
  }
  walk_runs(tag, band, reach_px, cap);
  PENUMBRA_ASSERT(tag.used <= tag.capacity);
  locate_samples(tag);
  finish_samples(tag);
}

// Each of the lattice's two directions in even steps over all of its edges, about `stride` pixels
// along the image axis that they are nearer to.
void TagAligner::Impl::step_along(Tag& tag, const Band& band, double reach_px, double stride) {
  const std::array<Eigen::Vector2d, 2> cell_px = {tag.along_a, tag.along_b};
  const std::array<int, 2> cells = {edge_cells(tag, 0), edge_cells(tag, 1)};
  std::array<int, 2> counts{};
  for (const std::size_t k : {0U, 1U})
    counts[k] = static_cast<int>(cells[k] * cell_px[k].cwiseAbs().maxCoeff() / stride + 0.5);
  const int most_rows = rows_at_most(band, reach_px);
  // What is written is up to three pixels more than are counted.
  take_samples(tag, most_rows * (counts[0] + counts[1]) + 4);
  tag.step_count = counts[0] + counts[1];
  if (const auto most = static_cast<std::size_t>(tag.step_count) + 16; tag.step_run.size() < most) {
    tag.step_end.resize(most);
    tag.step_run.resize(most);
  }
  std::array<float, 9> M{};
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c)
      M[static_cast<std::size_t>(3 * r + c)] = static_cast<float>(tag.ray_from_lattice(r, c));
  }
  // Rows across an edge, from the first one of a step.
  std::array<float, 20> offsets = {0.0F,  1.0F,  2.0F,  3.0F,  4.0F,  5.0F,  6.0F,
                                   7.0F,  8.0F,  9.0F,  10.0F, 11.0F, 12.0F, 13.0F,
                                   14.0F, 15.0F, 16.0F, 17.0F, 18.0F, 19.0F};
  for (int k = 0; k < band.count; ++k) {
    const auto at = static_cast<std::size_t>(k);
    offsets[at] = static_cast<float>(band.offsets[at]);
  }
  kernel::Walk walk;
  walk.ray_from_lattice = M.data();
  walk.width = image.width;
  walk.height = image.height;
  walk.stride = image.stride;
  walk.reach_px = static_cast<float>(reach_px);
  walk.most_rows = most_rows;
  walk.band_count = band.count;
  walk.offsets = offsets.data();
  if (!tag.row_shear.isZero()) {
    const Eigen::Vector2f shear = (tag.row_shear / (1.0 - tag.row_shear.y())).cast<float>();
    walk.row = static_cast<float>(tag.row);
    walk.shear_x = shear.x();
    walk.shear_y = shear.y();
  }
  walk.end = tag.step_end.data();
  walk.run = tag.step_run.data();
  for (const std::size_t k : {0U, 1U}) {
    if (counts[k] == 0) continue;
    walk.cells = tag.edge_cells[k].data();
    walk.cell_count = cells[k];
    walk.count = counts[k];
    walk.along_b = k == 1;
    walk.along_x = std::abs(cell_px[k].x()) >= std::abs(cell_px[k].y());
    tag.used = kernel->walk(lens, walk, tag.samples, tag.used);
    walk.end += counts[k];
    walk.run += counts[k];
  }
}

// Each run is walked pixel by pixel along the image axis it is nearer to, and at each step the
// pixels across it that the blur reaches are taken.
void TagAligner::Impl::walk_runs(Tag& tag, const Band& band, double reach_px, int cap) {
  const bool wide = band.count > 0;
  double length = 0.0;
  double tilt = 0.0;  // along the other axis
  run_lengths.resize(tag.runs.size());
  if (tag.step_run.size() < tag.runs.size()) {
    tag.step_end.resize(tag.runs.size());
    tag.step_run.resize(tag.runs.size());
  }
  for (std::size_t k = 0; k < tag.runs.size(); ++k) {
    const auto [v0, v1, vertical] = tag.runs[k];
    run_lengths[k] = -1.0;
    if (!(tag.depth[v0] > 0.0F && tag.depth[v1] > 0.0F)) continue;
    const float x0 = tag.pixel_x[v0];
    const float y0 = tag.pixel_y[v0];
    const float x1 = tag.pixel_x[v1];
    const float y1 = tag.pixel_y[v1];
    const double dx = std::abs(static_cast<double>(x1 - x0));
    const double dy = std::abs(static_cast<double>(y1 - y0));
    length += std::max(dx, dy);
    tilt += std::min(dx, dy);
    const double walk = std::max(std::abs(static_cast<double>(x1) - static_cast<double>(x0)),
                                 std::abs(static_cast<double>(y1) - static_cast<double>(y0)));
    if (walk > 1e-6 && std::max(std::abs(x0), std::abs(y0)) < 1e5F &&
        std::max(std::abs(x1), std::abs(y1)) < 1e5F)
      run_lengths[k] = walk;
  }
  if (!(length > 0.0) || !(length < 1e7)) return;
  const double stride = stride_of(band, reach_px, length, tilt, cap);
  const int most_rows = rows_at_most(band, reach_px);
  // The steps go on from run to run. What is written is up to three pixels more than are counted.
  const int capacity = most_rows * (static_cast<int>(length / stride) + 2) + 4;
  take_samples(tag, capacity);
  const kernel::Samples s = tag.samples;  // a copy, which the floats that are written are not
  // Rows across an edge, from the first one of a step.
  std::array<float, 20> offsets{};
  for (std::size_t k = 0; k < offsets.size(); ++k)
    offsets[k] = wide ? static_cast<float>(band.offsets[std::min<std::size_t>(k, 15)])
                      : static_cast<float>(k);
  int used = 0;
  double carry = 0.5 * stride;  // from a run's start to its first step
  for (std::size_t k = 0; k < tag.runs.size(); ++k) {
    const double run_length = run_lengths[k];
    if (carry >= run_length) {
      if (run_length > 0.0) carry -= run_length;
      continue;
    }
    const auto [v0, v1, vertical] = tag.runs[k];
    double x0 = static_cast<double>(tag.pixel_x[v0]);
    double y0 = static_cast<double>(tag.pixel_y[v0]);
    double x1 = static_cast<double>(tag.pixel_x[v1]);
    double y1 = static_cast<double>(tag.pixel_y[v1]);
    const bool along_x = std::abs(x1 - x0) >= std::abs(y1 - y0);
    if (!along_x) {
      std::swap(x0, y0);
      std::swap(x1, y1);
    }
    // Now x is the direction of the walk.
    const double direction = x1 < x0 ? -1.0 : 1.0;
    const double inverse_length = 1.0 / run_length;
    const double slope = (y1 - y0) * inverse_length;
    const int walk_limit = along_x ? image.width : image.height;
    const int cross_limit = along_x ? image.height : image.width;
    const auto rx0 = static_cast<double>(tag.ray_x[v0]);
    const auto ry0 = static_cast<double>(tag.ray_y[v0]);
    const double drx = (static_cast<double>(tag.ray_x[v1]) - rx0) * inverse_length;
    const double dry = (static_cast<double>(tag.ray_y[v1]) - ry0) * inverse_length;
    const double run_reach = std::min(reach_px * std::sqrt(1.0 + slope * slope), 8.0);
    float* const walk_out = along_x ? s.pixel_x : s.pixel_y;
    float* const cross_out = along_x ? s.pixel_y : s.pixel_x;
    int first = 0;
    int count = band.count;
    double at = carry;
    for (; at < run_length; at += stride) {
      const int walk = floor_of(x0 + direction * at + 0.5);
      if (walk < 0 || walk >= walk_limit) continue;
      const double exact = direction * (walk - x0);  // where this pixel's centre is along the run
      if (wide) {
        first = floor_of(y0 + slope * exact);
        if (first + band.offsets[0] < 0 ||
            first + band.offsets[static_cast<std::size_t>(band.count - 1)] >= cross_limit)
          continue;
      } else {
        first = ceil_of(y0 + slope * exact - run_reach);
        count =
            std::min(floor_of(y0 + slope * exact + run_reach), first + most_rows - 1) - first + 1;
        if (first < 0 || first + count > cross_limit) continue;
      }
      const Four walk_4 = all_four(static_cast<float>(walk));
      const Four cross_4 = all_four(static_cast<float>(first));
      const Four guess_x = all_four(static_cast<float>(rx0 + drx * exact));
      const Four guess_y = all_four(static_cast<float>(ry0 + dry * exact));
      // How many there are changes from step to step, and no processor foresees it: always four or
      // eight are written, those too many over again by the next step.
      for (int i = 0; i < count; i += 4) {
        store(walk_out + used + i, walk_4);
        store(cross_out + used + i, cross_4 + load(offsets.data() + i));
        store(s.ray_x + used + i, guess_x);
        store(s.ray_y + used + i, guess_y);
      }
      used += std::max(count, 0);
    }
    carry = at - run_length;
    tag.step_end[static_cast<std::size_t>(tag.step_count)] = used;
    tag.step_run[static_cast<std::size_t>(tag.step_count)] = static_cast<std::int32_t>(k);
    ++tag.step_count;
  }
  tag.used = used;
}

std::vector<EdgePixel> TagAligner::Impl::edge_pixels() {
  constexpr double kWider = 1.02;  // for the derivative by differences
  const double wider_px2 = (kWider * kWider - 1.0) * options.blur_px * options.blur_px;
  std::vector<EdgePixel> pixels;
  for (std::size_t k = 0; k < result.tags.size(); ++k) {
    if (!result.tags[k].verified) continue;
    Tag& tag = tags[static_cast<std::size_t>(result.tags[k].index)];
    PENUMBRA_ASSERT(tag.row_shear.isZero() && tag.motion_px.isZero());
    project_lattice(tag, 0.0);
    arena.give_back();
    select(tag, false,
           options.effort == AlignmentEffort::accurate ? 1'000'000 : options.samples_per_tag);
    kernel::Samples& s = tag.samples;
    kernel::AccumulateInput in;
    std::copy(tag.lattice_from_ray.begin(), tag.lattice_from_ray.end(), in.lattice_from_ray);
    in.reach = tag.reach;
    in.correlated = tag.correlated;
    kernel->evaluate(in, s);
    const std::size_t first = pixels.size();
    for (int i = 0; i < tag.used; ++i) {
      const std::uint8_t grey =
          image.row(static_cast<int>(s.pixel_y[i]))[static_cast<int>(s.pixel_x[i])];
      pixels.push_back({static_cast<int>(k), static_cast<float>(grey), s.model[i], 0.0F});
    }
    project_lattice(tag, wider_px2);
    for (int i = 0; i < s.count; ++i) {
      const auto v = static_cast<std::size_t>(s.vertex[i]);
      s.ka[i] = tag.ka[v];
      s.kb[i] = tag.kb[v];
      s.rho[i] = tag.rho[v];
    }
    kernel->evaluate(in, s);
    const auto per_log = static_cast<float>(1.0 / std::log(kWider));
    for (int i = 0; i < tag.used; ++i) {
      EdgePixel& pixel = pixels[first + static_cast<std::size_t>(i)];
      pixel.model_blur = (s.model[i] - pixel.model) * per_log;
    }
  }
  return pixels;
}

}  // namespace penumbra
