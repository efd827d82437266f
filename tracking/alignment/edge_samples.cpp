#include "tracking/alignment/edge_samples.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Returns the number of edge cells along one lattice direction.
int edge_cells(const AlignedTag& tag, std::size_t direction) {
  const auto& cells = tag.edge_cells[direction];
  return cells.empty() ? 0 : static_cast<int>(cells.size()) - 1;
}

double mean_of(const std::array<double, 2>& reach_px) {
  return 0.5 * (reach_px[0] + reach_px[1]);
}

}  // namespace

int EdgeSampler::Band::max_row_count(double reach_px) const {
  return count > 0 ? count : std::min(static_cast<int>(3.0 * reach_px) + 2, 17);
}

double EdgeSampler::Band::stride(double reach_px, double length, double tilt, int cap) const {
  const double steepness = std::sqrt(1.0 + (tilt / length) * (tilt / length));
  const double rows = count > 0 ? count : std::min(2.0 * reach_px * steepness, 16.0);
  return std::max(1.0, length * rows / cap);
}

std::array<float, 20> EdgeSampler::Band::row_offsets() const {
  std::array<float, 20> rows;
  std::iota(rows.begin(), rows.end(), 0.0F);
  std::copy_n(offsets.begin(), count, rows.begin());
  return rows;
}

void EdgeSampler::read_levels() {
  for (AlignedTag* tag : problem_.active) {
    double white = 0.0;
    double black = 0.0;
    int whites = 0;
    int blacks = 0;
    const std::int32_t* const places = problem_.find_cell_pixels(*tag);
    for (const DataCell& cell : tag->pattern.data_cells()) {
      const std::int32_t place = places[cell.j * tag->side + cell.i];
      if (place == simd::kNowhere) continue;
      const double value = static_cast<double>(problem_.tone[problem_.image.data[place]]);
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

void EdgeSampler::locate_samples(AlignedTag& tag) const {
  const simd::Samples& s = tag.samples;  // `vertex`: here a memory offset, later the anchor
  const auto stride = static_cast<std::int32_t>(problem_.image.stride);
  for (int i = 0; i < tag.used; ++i)
    s.vertex[i] =
        static_cast<std::int32_t>(s.pixel_y[i]) * stride + static_cast<std::int32_t>(s.pixel_x[i]);
}

// Completes samples that have pixels, memory offsets (in `vertex`) and initial rays.
void EdgeSampler::finish_samples(AlignedTag& tag) {
  PENUMBRA_ASSERT(tag.used <= tag.capacity);
  tag.samples.count = padded(tag.used);
  const simd::Samples s = tag.samples;  // a copy: stores to the arrays can't change it
  problem_.loops->read(problem_.image.data, problem_.tone.data(), tag.used, s);
  if (!tag.row_shear.isZero()) {
    // Moves the samples to where they would be if all rows were read at the time of the tag's row.
    const auto row = static_cast<float>(tag.row);
    const Eigen::Vector2f shear = tag.row_shear.cast<float>();
    for (int i = 0; i < s.count; ++i) {
      const float rows = s.pixel_y[i] - row;
      s.pixel_x[i] -= shear.x() * rows;
      s.pixel_y[i] -= shear.y() * rows;
    }
  }
  problem_.loops->prepare(problem_.lens, tag.lattice_from_ray.data(), tag.reach, tag.side, s);
  if (tag.is_curved) flatten(tag);
  if (tag.moments == 1) {
    attach(tag, s);
    return;
  }
  remove_samples_near_outline(tag);
  for (int k = 0; k < tag.moments; ++k) {
    const auto moment = static_cast<std::size_t>(k);
    simd::Samples& s_k = tag.moment_samples[moment];
    s_k = tag.samples;
    if (k > 0) arena_.allocate_anchors(tag.reach, s_k);
    problem_.loops->anchor(tag.moment_inputs[moment].lattice_from_ray, tag.reach, tag.side, s_k);
    attach(tag, s_k);
  }
}

void EdgeSampler::flatten(AlignedTag& tag) const {
  simd::CurvedPaper paper;
  std::ranges::copy(tag.height, paper.height);
  paper.half = static_cast<float>(0.5 * (tag.side - 1));
  for (int k = 0; k < 3; ++k) paper.camera[k] = static_cast<float>(tag.centre[k]);
  std::ranges::copy(rows_of(tag.ray_from_lattice), paper.ray_from_lattice);
  std::ranges::copy(tag.lattice_from_ray, paper.lattice_from_ray);
  problem_.loops->flatten(paper, tag.reach, tag.side, tag.samples);
}

void EdgeSampler::follow_shear(AlignedTag& tag) const {
  constexpr double kUnnoticed_px = 0.01;  // at the tag's first and last row
  const Eigen::Vector2d shear = problem_.shear_of(tag);
  const Eigen::Vector2d change = shear - tag.row_shear;
  const double half_rows =
      0.5 * (tag.side - 1) * (std::abs(tag.along_a.y()) + std::abs(tag.along_b.y()));
  // Samples of several moments keep their displacements until the next selection.
  if (tag.moments > 1 || tag.used == 0 || !(change.norm() * half_rows > kUnnoticed_px)) return;
  const simd::Samples s = tag.samples;  // a copy: stores to the arrays can't change it
  const auto row = static_cast<float>(tag.row);
  const auto to_pixel = static_cast<float>(1.0 / (1.0 - tag.row_shear.y()));
  const Eigen::Vector2f moved = change.cast<float>();
  for (int i = 0; i < s.count; ++i) {
    const float rows = (s.pixel_y[i] - row) * to_pixel;
    s.pixel_x[i] -= moved.x() * rows;
    s.pixel_y[i] -= moved.y() * rows;
  }
  tag.row_shear = shear;
  problem_.loops->prepare(problem_.lens, tag.lattice_from_ray.data(), tag.reach, tag.side, s);
  if (tag.is_curved) flatten(tag);
  attach(tag, s);
}

// Removes samples that mix with light from beside the tag at the start or end of the exposure.
void EdgeSampler::remove_samples_near_outline(AlignedTag& tag) const {
  const simd::Samples& s = tag.samples;
  // A line affects pixels up to 2.5 sigma away.
  const Eigen::Vector2f near = (2.5 * tag.sigma_cells).cast<float>();
  const auto on_paper = [&](const float* M, int i) {
    const float x = s.ray_x[i];
    const float y = s.ray_y[i];
    const float inverse = 1.0F / (M[6] * x + M[7] * y + M[8]);
    const float a = (M[0] * x + M[1] * y + M[2]) * inverse;
    const float b = (M[3] * x + M[4] * y + M[5]) * inverse;
    const auto last = static_cast<float>(tag.side - 1);
    if (!(a > near.x() && b > near.y() && a < last - near.x() && b < last - near.y())) return false;
    for (const float near_a : {a - near.x(), a + near.x()}) {
      for (const float near_b : {b - near.y(), b + near.y()}) {
        if (!tag.pattern.printed(static_cast<int>(near_a), static_cast<int>(near_b))) return false;
      }
    }
    return true;
  };
  const float* const first = tag.moment_inputs[0].lattice_from_ray;
  const float* const end =
      tag.moment_inputs[static_cast<std::size_t>(tag.moments - 1)].lattice_from_ray;
  int kept = 0;
  for (int i = 0; i < tag.used; ++i) {
    if (!on_paper(first, i) || !on_paper(end, i)) continue;
    for (float* array : {s.pixel_x, s.pixel_y, s.ray_x, s.ray_y, s.value}) array[kept] = array[i];
    ++kept;
  }
  for (int i = kept; i < tag.used; ++i) s.weight[i] = 0.0F;
  tag.used = kept;
  tag.samples.count = padded(kept);
}

// Sets the samples' members that depend on their anchors; see simd::Samples.
void EdgeSampler::attach(const AlignedTag& tag, const simd::Samples& samples) const {
  const simd::Samples s = samples;  // a copy: stores to the arrays can't change it
  if (tag.reach == 1) {
    problem_.loops->attach(tag.ka.data(), tag.kb.data(), tag.coefficients1.front().data(), s);
    if (tag.correlated) {
      for (int i = 0; i < s.count; ++i) s.rho[i] = tag.rho[static_cast<std::size_t>(s.vertex[i])];
    }
    return;
  }
  const std::vector<std::array<float, 16>>& table =
      tag.reach == 2 ? tag.coefficients2 : tag.coefficients3;
  for (int i = 0; i < s.count; ++i) {
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

void EdgeSampler::allocate_samples(AlignedTag& tag, int capacity) {
  tag.capacity = capacity;
  arena_.allocate(capacity, tag.reach, tag.samples);
  // The loops write whole blocks.
  if (const auto room = static_cast<std::size_t>(capacity + simd::kBlock); tag.vertex.size() < room)
    tag.vertex.resize(room + room / 2);
  tag.samples.vertex = tag.vertex.data();
}

void EdgeSampler::evaluate(AlignedTag& tag) const {
  const bool moments = tag.moments > 1;
  simd::AccumulateInput single;
  std::ranges::copy(tag.lattice_from_ray, single.lattice_from_ray);
  simd::AccumulateInput* const inputs = moments ? tag.moment_inputs.data() : &single;
  inputs->reach = tag.reach;
  inputs->correlated = tag.correlated;
  problem_.loops->evaluate(inputs, moments ? tag.moment_samples.data() : &tag.samples, tag.moments);
}

void EdgeSampler::select(AlignedTag& tag, bool wide, int cap) {
  tag.used = 0;
  tag.step_count = 0;
  tag.thinned = false;
  Band band;
  if (wide) {
    // The offsets extend half a cell to each side of the edge.
    const double unit = std::max(tag.cell_px / 10.0, 0.3);
    for (const double o : {-5.0, -3.0, -1.0, 1.0, 3.0, 5.0})
      band.offsets[static_cast<std::size_t>(band.count++)] = floor_of(o * unit + 0.5);
  }
  // 2.1 sigma contain all but 1/200 of an edge's information.
  const double sigmas = problem_.options.effort == AlignmentEffort::accurate ? 2.1 : 1.25;
  // Only motion across an edge blurs it.
  const auto reach_across = [&](const Eigen::Vector2d& along) {
    const double across_px =
        (along.x() * tag.motion_px.y() - along.y() * tag.motion_px.x()) / along.norm();
    return sigmas * std::sqrt(problem_.options.blur_px * problem_.options.blur_px +
                              across_px * across_px / 12.0);
  };
  std::array<double, 2> reach_px;
  reach_px.fill(sigmas * problem_.options.blur_px);
  if (!tag.motion_px.isZero(0.0)) reach_px = {reach_across(tag.along_a), reach_across(tag.along_b)};
  // With shorter steps, perspective may bring two steps to the same pixel.
  constexpr double kMinStep_px = 1.5;
  // With fewer tags, the tilt of the pose depends on single edges, so each edge is walked.
  constexpr std::size_t kMinTags = 3;
  if (problem_.active.size() >= kMinTags) {
    double length = 0.0;  // total extent of the edges along their nearer image axes [px]
    double tilt = 0.0;    // total extent of the edges along the other image axes [px]
    for (const auto& [direction, cell_px] :
         {std::pair(0U, tag.along_a), std::pair(1U, tag.along_b)}) {
      const double cells = edge_cells(tag, direction);
      length += cells * cell_px.cwiseAbs().maxCoeff();
      tilt += cells * cell_px.cwiseAbs().minCoeff();
    }
    const double stride = band.stride(mean_of(reach_px), length, tilt, cap);
    if (stride > kMinStep_px && length < 1e7) {
      tag.thinned = true;
      step_along(tag, band, reach_px, stride);
      finish_samples(tag);
      return;
    }
  }
  walk_runs(tag, band, reach_px, cap);
  finish_samples(tag);
}

// `steps`: number of steps or runs.
void EdgeSampler::fill_plan(const Band& band, const std::array<float, 20>& offsets, int steps,
                            AlignedTag& tag, simd::WalkPlan& plan) const {
  if (const auto room = static_cast<std::size_t>(steps); tag.step_run.size() < room) {
    tag.step_end.resize(room);
    tag.step_run.resize(room);
  }
  plan.width = problem_.image.width;
  plan.height = problem_.image.height;
  plan.stride = problem_.image.stride;
  plan.band_count = band.count;
  plan.offsets = offsets.data();
  plan.end = tag.step_end.data();
  plan.run = tag.step_run.data();
}

// Samples each lattice direction in steps of about `stride` px along all of its edges.
void EdgeSampler::step_along(AlignedTag& tag, const Band& band,
                             const std::array<double, 2>& reach_px, double stride) {
  const std::array<Eigen::Vector2d, 2> cell_px = {tag.along_a, tag.along_b};
  const std::array<int, 2> cells = {edge_cells(tag, 0), edge_cells(tag, 1)};
  std::array<int, 2> counts{};
  for (const std::size_t k : {0U, 1U})
    counts[k] = static_cast<int>(cells[k] * cell_px[k].cwiseAbs().maxCoeff() / stride + 0.5);
  const std::array<int, 2> max_rows = {band.max_row_count(reach_px[0]),
                                       band.max_row_count(reach_px[1])};
  // The loops may write three pixels beyond the end.
  allocate_samples(tag, max_rows[0] * counts[0] + max_rows[1] * counts[1] + 4);
  tag.step_count = counts[0] + counts[1];
  const std::array<float, 9> M = rows_of(tag.ray_from_lattice);
  const std::array<float, 20> offsets = band.row_offsets();
  simd::Walk walk;
  walk.ray_from_lattice = M.data();
  fill_plan(band, offsets, tag.step_count + 16, tag, walk);
  if (!tag.row_shear.isZero()) {
    const Eigen::Vector2f shear = (tag.row_shear / (1.0 - tag.row_shear.y())).cast<float>();
    walk.row = static_cast<float>(tag.row);
    walk.shear_x = shear.x();
    walk.shear_y = shear.y();
  }
  for (const std::size_t k : {0U, 1U}) {
    if (counts[k] == 0) continue;
    walk.cells = tag.edge_cells[k].data();
    walk.cell_count = cells[k];
    walk.count = counts[k];
    walk.reach_px = static_cast<float>(reach_px[k]);
    walk.max_rows = max_rows[k];
    walk.along_b = k == 1;
    walk.along_x = std::abs(cell_px[k].x()) >= std::abs(cell_px[k].y());
    tag.used = problem_.loops->walk(problem_.lens, walk, tag.samples, tag.used);
    walk.end += counts[k];
    walk.run += counts[k];
  }
}

// Samples each run in steps along its nearer image axis.
void EdgeSampler::walk_runs(AlignedTag& tag, const Band& band,
                            const std::array<double, 2>& reach_px, int cap) {
  simd::RunWalk walk;
  constexpr auto kPart = static_cast<std::size_t>(simd::RunWalk::Part::kRuns);
  if (const std::size_t parts = (tag.runs.size() + kPart - 1) / kPart; run_parts_.size() < parts)
    run_parts_.resize(parts);
  walk.runs = tag.runs.data();
  walk.count = static_cast<int>(tag.runs.size());
  walk.ray_x = tag.ray_x.data();
  walk.ray_y = tag.ray_y.data();
  walk.pixel_x = tag.pixel_x.data();
  walk.pixel_y = tag.pixel_y.data();
  walk.depth = tag.depth.data();
  walk.parts = run_parts_.data();
  walk.reach_px = reach_px[0];
  double length = 0.0;
  double tilt = 0.0;  // total extent of the runs along the other image axis
  problem_.loops->measure_runs(walk, length, tilt);
  if (!(length > 0.0) || !(length < 1e7)) return;
  if (reach_px[1] != reach_px[0]) {
    for (std::size_t k = 0; k < tag.runs.size(); ++k) {
      if (!tag.runs[k].vertical) continue;
      simd::RunWalk::Part& part = run_parts_[k / kPart];
      const double slope = part.slope[k % kPart];
      part.reach[k % kPart] = std::min(reach_px[1] * std::sqrt(1.0 + slope * slope), 8.0);
    }
  }
  walk.stride_px = band.stride(mean_of(reach_px), length, tilt, cap);
  tag.thinned = walk.stride_px > 1.0;
  walk.max_rows = band.max_row_count(std::max(reach_px[0], reach_px[1]));
  // The loops may write three pixels beyond the end.
  allocate_samples(tag, walk.max_rows * (static_cast<int>(length / walk.stride_px) + 2) + 4);
  const std::array<float, 20> offsets = band.row_offsets();
  fill_plan(band, offsets, walk.count, tag, walk);
  tag.used = problem_.loops->walk_runs(problem_.lens, walk, tag.samples);
  tag.step_count = walk.walked;
}

void EdgeSampler::read_cells(AlignedTag& tag) {
  const std::vector<DataCell>& cells = tag.pattern.data_cells();
  allocate_samples(tag, static_cast<int>(cells.size()));
  simd::Samples& s = tag.samples;
  tag.used = 0;
  tag.step_count = 0;
  for (const DataCell& cell : cells) {
    int px = 0;
    int py = 0;
    if (!problem_.nearest_cell_pixel(tag, cell, px, py)) continue;
    const auto v = static_cast<std::size_t>(cell.j * tag.side + cell.i);
    s.pixel_x[tag.used] = static_cast<float>(px);
    s.pixel_y[tag.used] = static_cast<float>(py);
    s.ray_x[tag.used] = tag.ray_x[v];
    s.ray_y[tag.used] = tag.ray_y[v];
    ++tag.used;
  }
  locate_samples(tag);
  finish_samples(tag);
  evaluate(tag);
}

void EdgeSampler::average_cells(AlignedTag& tag) const {
  const simd::Samples& s = tag.samples;
  const int half = std::min(static_cast<int>(tag.cell_px / 6.0), 3);  // half width [px]
  // With a rolling shutter, samples are displaced from their pixels.
  if (half == 0 || !tag.row_shear.isZero(0.0)) return;
  for (int k = 0; k < tag.used; ++k) {
    const int x = static_cast<int>(s.pixel_x[k]);
    const int y = static_cast<int>(s.pixel_y[k]);
    float sum = 0.0F;
    int count = 0;
    for (int v = std::max(y - half, 0); v <= std::min(y + half, problem_.image.height - 1); ++v) {
      for (int u = std::max(x - half, 0); u <= std::min(x + half, problem_.image.width - 1); ++u) {
        sum += problem_.tone[problem_.image.data[v * problem_.image.stride + u]];
        ++count;
      }
    }
    s.value[k] = sum / static_cast<float>(count);
  }
}

std::vector<EdgePixel> EdgeSampler::edge_pixels(std::span<const TagAlignment> seen) {
  constexpr double kWider = 1.02;  // blur factor for the numerical derivative
  const double wider_px2 =
      (kWider * kWider - 1.0) * problem_.options.blur_px * problem_.options.blur_px;
  std::vector<EdgePixel> pixels;
  for (std::size_t k = 0; k < seen.size(); ++k) {
    if (!seen[k].verified) continue;
    AlignedTag& tag = problem_.tags[static_cast<std::size_t>(seen[k].index)];
    PENUMBRA_ASSERT(tag.row_shear.isZero() && tag.motion_px.isZero());
    problem_.project_lattice(tag, 0.0);
    arena_.free_samples();
    select(tag, false, kEveryPixel);
    simd::Samples& s = tag.samples;
    evaluate(tag);
    const std::size_t first = pixels.size();
    for (int i = 0; i < tag.used; ++i) {
      const std::uint8_t grey =
          problem_.image.row(static_cast<int>(s.pixel_y[i]))[static_cast<int>(s.pixel_x[i])];
      pixels.push_back({static_cast<int>(k), static_cast<float>(grey), s.model[i], 0.0F});
    }
    problem_.project_lattice(tag, wider_px2);
    for (int i = 0; i < s.count; ++i) {
      const auto v = static_cast<std::size_t>(s.vertex[i]);
      s.ka[i] = tag.ka[v];
      s.kb[i] = tag.kb[v];
      s.rho[i] = tag.rho[v];
    }
    evaluate(tag);
    const auto per_log = static_cast<float>(1.0 / std::log(kWider));
    for (int i = 0; i < tag.used; ++i) {
      EdgePixel& pixel = pixels[first + static_cast<std::size_t>(i)];
      pixel.model_blur = (s.model[i] - pixel.model) * per_log;
    }
  }
  return pixels;
}

}  // namespace penumbra
