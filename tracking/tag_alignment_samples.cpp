// Which pixels an alignment looks at, and what it needs to know about each.

#include "tracking/tag_alignment_state.hpp"

#include <algorithm>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Places along the rows across an edge that are sampled, in pixels from the edge's own pixel.
struct Band {
  std::array<int, 16> offsets{};
  int count = 0;
};

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
  kernel::Samples& s = tag.samples;
  const int padded = (tag.used + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
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
  s.count = padded;
  kernel->prepare(lens, tag.lattice_from_ray.data(), tag.reach, tag.side, s);
  // What depends on the anchor alone. One record per vertex; gathering it here is faster than by
  // vector instructions.
  if (tag.reach == 1) {
    for (int i = 0; i < padded; ++i) {
      const auto v = static_cast<std::size_t>(s.vertex[i]);
      const std::array<float, 4>& c = tag.coefficients1[v];
      s.ka[i] = tag.ka[v];
      s.kb[i] = tag.kb[v];
      s.rho[i] = tag.rho[v];
      s.c[0][i] = c[0];
      s.c[1][i] = c[1];
      s.c[2][i] = c[2];
      s.c[3][i] = c[3];
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
  const std::vector<EdgeRun>& runs = tag.pattern.runs();
  const auto vertex = [&](const EdgeRun& run, int along) {
    return static_cast<std::size_t>(run.vertical ? along * tag.side + run.position
                                                 : run.position * tag.side + along);
  };
  double length = 0.0;
  double tilt = 0.0;  // mean share of the minor direction
  for (const EdgeRun& run : runs) {
    const std::size_t v0 = vertex(run, run.begin);
    const std::size_t v1 = vertex(run, run.end);
    if (!(tag.depth[v0] > 0.0F && tag.depth[v1] > 0.0F)) continue;
    const double dx = std::abs(static_cast<double>(tag.pixel_x[v1] - tag.pixel_x[v0]));
    const double dy = std::abs(static_cast<double>(tag.pixel_y[v1] - tag.pixel_y[v0]));
    length += std::max(dx, dy);
    tilt += std::min(dx, dy);
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
  const int capacity =
      most_rows * (static_cast<int>(length / stride) + 2 * static_cast<int>(runs.size()) + 4);
  tag.storage.resize(capacity);
  tag.samples = tag.storage.view();
  kernel::Samples& s = tag.samples;
  int used = 0;
  double carry = 0.5 * stride;  // from a run's start to its first step
  for (const EdgeRun& run : runs) {
    const std::size_t v0 = vertex(run, run.begin);
    const std::size_t v1 = vertex(run, run.end);
    if (!(tag.depth[v0] > 0.0F && tag.depth[v1] > 0.0F)) continue;
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
    const double span = x1 - x0;
    const double run_length = std::abs(span);
    if (!(run_length > 1e-6 && std::abs(x0) < 1e5 && std::abs(y0) < 1e5 && std::abs(x1) < 1e5 &&
          std::abs(y1) < 1e5))
      continue;
    const double direction = span < 0.0 ? -1.0 : 1.0;
    if (carry >= run_length) {
      carry -= run_length;
      continue;
    }
    const double inverse_length = 1.0 / run_length;
    const double slope = (y1 - y0) * inverse_length;
    const int walk_limit = along_x ? image.width : image.height;
    const int cross_limit = along_x ? image.height : image.width;
    const auto rx0 = static_cast<double>(tag.ray_x[v0]);
    const auto ry0 = static_cast<double>(tag.ray_y[v0]);
    const double drx = (static_cast<double>(tag.ray_x[v1]) - rx0) * inverse_length;
    const double dry = (static_cast<double>(tag.ray_y[v1]) - ry0) * inverse_length;
    const double run_reach = std::min(reach_px * std::sqrt(1.0 + slope * slope), 8.0);
    int first = 0;
    int last = 0;
    double at = carry;
    for (; at < run_length; at += stride) {
      const int walk = floor_of(x0 + direction * at + 0.5);
      if (walk < 0 || walk >= walk_limit) continue;
      const double exact = direction * (walk - x0);  // where this pixel's centre is along the run
      const int cross = floor_of(y0 + slope * exact);
      if (wide) {
        if (cross + band.offsets[0] < 0 ||
            cross + band.offsets[static_cast<std::size_t>(band.count - 1)] >= cross_limit)
          continue;
      } else {
        first = ceil_of(y0 + slope * exact - run_reach);
        last = std::min(floor_of(y0 + slope * exact + run_reach), first + most_rows - 1);
        if (first < 0 || last >= cross_limit) continue;
      }
      const auto guess_x = static_cast<float>(rx0 + drx * exact);
      const auto guess_y = static_cast<float>(ry0 + dry * exact);
      const int count = wide ? band.count : last - first + 1;
      for (int k = 0; k < count; ++k) {
        const int across = wide ? cross + band.offsets[static_cast<std::size_t>(k)] : first + k;
        s.pixel_x[used] = static_cast<float>(along_x ? walk : across);
        s.pixel_y[used] = static_cast<float>(along_x ? across : walk);
        s.ray_x[used] = guess_x;
        s.ray_y[used] = guess_y;
        ++used;
      }
    }
    carry = at - run_length;
    tag.run_samples.push_back({used, run.vertical});
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
