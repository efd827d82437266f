// Which pixels an alignment looks at, and what it needs to know about each.

#include "tracking/tag_alignment_state.hpp"

#include <algorithm>
#include <cstring>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Places along the rows across an edge that are sampled, in pixels from the edge's own pixel.
struct Band {
  std::array<int, 16> offsets{};
  int count = 0;
};

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

// Fills in what the kernel needs beside pixels and guesses of their rays.
void TagAligner::Impl::finish_samples(Tag& tag) {
  const kernel::Samples s = [&] {
    tag.samples.count = (tag.used + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
    return tag.samples;  // a copy, which the floats that are written are not
  }();
  const int padded = s.count;
  for (int i = 0; i < tag.used; ++i) {
    s.value[i] = tone[image.row(static_cast<int>(s.pixel_y[i]))[static_cast<int>(s.pixel_x[i])]];
    s.weight[i] = 1.0F;
  }
  if (!tag.row_shear.isZero()) {
    // From here on the samples are where they would be, had their rows been read out with the
    // tag's.
    const auto row = static_cast<float>(tag.row);
    const Eigen::Vector2f shear = tag.row_shear.cast<float>();
    for (int i = 0; i < tag.used; ++i) {
      const float rows = s.pixel_y[i] - row;
      s.pixel_x[i] -= shear.x() * rows;
      s.pixel_y[i] -= shear.y() * rows;
    }
  }
  for (int i = tag.used; i < padded; ++i) {
    const int last = tag.used > 0 ? tag.used - 1 : 0;
    s.pixel_x[i] = tag.used > 0 ? s.pixel_x[last] : 0.0F;
    s.pixel_y[i] = tag.used > 0 ? s.pixel_y[last] : 0.0F;
    s.ray_x[i] = tag.used > 0 ? s.ray_x[last] : 0.0F;
    s.ray_y[i] = tag.used > 0 ? s.ray_y[last] : 0.0F;
    s.value[i] = 0.0F;
    s.weight[i] = 0.0F;
  }
  kernel->prepare(lens, tag.lattice_from_ray.data(), tag.reach, tag.side, s);
  // What depends on the anchor alone. One record per vertex; gathering it here is faster than by
  // vector instructions.
  if (tag.reach == 1) {
    for (int i = 0; i < padded; ++i) {
      const auto v = static_cast<std::size_t>(s.vertex[i]);
      s.ka[i] = tag.ka[v];
      s.kb[i] = tag.kb[v];
      s.rho[i] = tag.rho[v];
    }
    // Four records of four become four of each.
    for (int i = 0; i < padded; i += 4) {
      const auto record = [&](int k) {
        return load(tag.coefficients1[static_cast<std::size_t>(s.vertex[i + k])].data());
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

// Chooses the pixels at the edges: each run is walked pixel by pixel along the image axis it is
// nearer to, and at each step the pixels across it that the blur reaches are taken.
void TagAligner::Impl::select(Tag& tag, bool wide, int cap) {
  double length = 0.0;
  double tilt = 0.0;  // mean share of the minor direction
  run_lengths.resize(tag.runs.size());
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
  tag.used = 0;
  tag.run_samples.clear();
  if (!(length > 0.0) || !(length < 1e7)) {
    finish_samples(tag);
    return;
  }

  const double motion = tag.motion_px.norm() / std::sqrt(12.0);
  const double sigma = std::hypot(options.blur_px, motion);
  Band band;
  if (wide) {
    // Far enough out to feel an edge half a cell away.
    const double unit = std::max(tag.cell_px / 10.0, 0.3);
    for (const double o : {-5.0, -3.0, -1.0, 1.0, 3.0, 5.0})
      band.offsets[static_cast<std::size_t>(band.count++)] =
          static_cast<int>(std::floor(o * unit + 0.5));
  }
  // Within 2.1 sigma of an edge lies all but a two-hundredth of what it tells; a limited number of
  // pixels is best spent closer.
  const double reach_px = (options.effort == AlignmentEffort::accurate ? 2.1 : 1.25) * sigma;
  const double steepness = std::hypot(1.0, tilt / length);
  const double rows = wide ? band.count : std::min(2.0 * reach_px * steepness, 16.0);
  const double stride = std::max(1.0, length * rows / cap);
  const int most_rows = wide ? band.count : std::min(static_cast<int>(3.0 * reach_px) + 2, 17);
  // The steps go on from run to run. What is written is up to three pixels more than are counted.
  const int capacity = most_rows * (static_cast<int>(length / stride) + 2) + 4;
  tag.storage.resize(capacity);
  tag.samples = tag.storage.view();
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
    tag.run_samples.push_back({used, vertical});
  }
  PENUMBRA_ASSERT(used <= tag.storage.capacity());
  tag.used = used;
  finish_samples(tag);
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
