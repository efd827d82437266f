#include "render/shadow/power_distance.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace penumbra {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
// A cell stands for its whole square, so its disc is half a cell larger.
constexpr float kHalfCell = 0.5F;
// Far from the light's axis the largest outline belongs to the top of a part and the best umbra to
// matter further down: the umbra is the union of those of all matter and of matter below these
// shares of the part's height.
constexpr std::array<double, 3> kLevels = {1.0, 0.5, 0.02};

// A projected corner: position on the plane and radius of the light's image there.
struct FieldPoint {
  float x, y, rho;
};

// Rectangle of cells of the whole field that a part can reach.
struct Window {
  int left = 0, bottom = 0, width = 0, height = 0;
};

class PartField {
 public:
  // Corners are in cells of the whole field.
  void cover(std::span<const FieldPoint> triangles, const Window& window) {
    window_ = window;
    const std::size_t count =
        static_cast<std::size_t>(window.width) * static_cast<std::size_t>(window.height);
    greatest_.assign(count, -1.0F);
    least_.assign(count, kInfinity);
    gap_x_.assign(count, kInfinity);
    gap_y_.assign(count, kInfinity);
    for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
      cover_triangle(triangles[i], triangles[i + 1], triangles[i + 2]);
    }
  }

  [[nodiscard]] bool covered(std::size_t index) const { return greatest_[index] >= 0.0F; }

  // Field value > 0 where some covered cell's disc reaches.
  const std::vector<float>& penumbra() {
    sites_.resize(greatest_.size());
    for (std::size_t i = 0; i < sites_.size(); ++i) {
      const float rho = greatest_[i] + kHalfCell;
      sites_[i] = greatest_[i] >= 0.0F ? -rho * rho : kInfinity;
    }
    transform();
    for (float& value : sites_) value = -value;
    return sites_;
  }

  // Roughly the signed distance to the outline, right beside it: > 0 in covered cells.
  const std::vector<float>& middle() {
    const auto stride = static_cast<std::size_t>(window_.width);
    sites_.resize(greatest_.size());
    for (std::size_t i = 0; i < sites_.size(); ++i) sites_[i] = covered(i) ? 1.0F : -1.0F;
    for (int row = 1; row + 1 < window_.height; ++row) {
      for (int column = 1; column + 1 < window_.width; ++column) {
        const std::size_t i = index_of(column, row);
        if (covered(i)) continue;
        const auto along = [&](std::size_t beside, float distance) {
          if (!covered(beside) || distance == kInfinity) return;
          // The zero between the two centres falls on the outline.
          sites_[i] = std::max(sites_[i], -distance);
          sites_[beside] = std::min(sites_[beside], 1.0F - distance);
        };
        along(i - 1, gap_x_[i]);
        along(i + 1, gap_x_[i]);
        along(i - stride, gap_y_[i]);
        along(i + stride, gap_y_[i]);
      }
    }
    return sites_;
  }

  // Field value > 0 in covered cells that no disc round the outline reaches.
  const std::vector<float>& umbra() {
    const int width = window_.width;
    const int height = window_.height;
    sites_.assign(greatest_.size(), kInfinity);
    const auto stride = static_cast<std::ptrdiff_t>(width);
    const std::array<std::ptrdiff_t, 8> steps = {-1,          1,           -stride,    stride,
                                                 -stride - 1, -stride + 1, stride - 1, stride + 1};
    for (int row = 2; row + 2 < height; ++row) {
      for (int column = 2; column + 2 < width; ++column) {
        const std::size_t i = index_of(column, row);
        if (covered(i)) continue;
        float rho = kInfinity;
        for (std::size_t direction = 0; direction < steps.size(); ++direction) {
          // Corners count only where no side is covered: they lie deeper inside.
          if (direction == 4 && rho < kInfinity) break;
          rho = std::min(rho, outline_rho(i, steps[direction]));
        }
        if (rho == kInfinity) continue;
        const float radius = rho + gap(i);
        sites_[i] = -radius * radius;
      }
    }
    transform();
    for (std::size_t i = 0; i < sites_.size(); ++i) {
      if (!covered(i)) sites_[i] = -std::abs(sites_[i]);
    }
    return sites_;
  }

 private:
  [[nodiscard]] std::size_t index_of(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(window_.width) +
           static_cast<std::size_t>(column);
  }

  // rho of the matter that makes the outline between an uncovered cell and the next one in a
  // direction, or infinity. Where the lower surface rises towards the outline, as on a round body,
  // it is followed half a cell further, at most to where it meets the upper one.
  [[nodiscard]] float outline_rho(std::size_t uncovered, std::ptrdiff_t step) const {
    const std::size_t near = uncovered + static_cast<std::size_t>(step);
    if (!covered(near)) return kInfinity;
    const std::size_t deep = near + static_cast<std::size_t>(step);
    if (!covered(deep)) return least_[near];
    const float rise = std::max(0.0F, least_[near] - least_[deep]);
    const float fall = std::max(0.0F, greatest_[deep] - greatest_[near]);
    if (rise <= 0.0F) return least_[near];
    return least_[near] +
           rise * std::min(kHalfCell, (greatest_[near] - least_[near]) / (rise + fall));
  }

  void cover_triangle(FieldPoint a, FieldPoint b, FieldPoint c) {
    if (b.y < a.y) std::swap(a, b);
    if (c.y < b.y) std::swap(b, c);
    if (b.y < a.y) std::swap(a, b);
    const auto bottom = static_cast<float>(window_.bottom);
    const auto left_edge = static_cast<float>(window_.left);
    // Corners lie inside the window by more than a cell: truncation rounds down.
    const int first_row = std::max(1, static_cast<int>(a.y - bottom + 0.5F));
    const int end_row = std::min(window_.height - 1, static_cast<int>(c.y - bottom + 0.5F));
    if (first_row >= end_row) return;
    const float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (area == 0.0F) return;
    // rho is linear in the image of a flat face.
    const float slope_x = ((b.rho - a.rho) * (c.y - a.y) - (c.rho - a.rho) * (b.y - a.y)) / area;
    const float slope_y = ((c.rho - a.rho) * (b.x - a.x) - (b.rho - a.rho) * (c.x - a.x)) / area;
    const float low = std::min(a.rho, std::min(b.rho, c.rho));
    const float high = std::max(a.rho, std::max(b.rho, c.rho));
    const auto slope = [](const FieldPoint& from, const FieldPoint& to) {
      const float rise = to.y - from.y;
      return rise > 0.0F ? (to.x - from.x) / rise : 0.0F;
    };
    const float slope_ac = slope(a, c);
    const float slope_ab = slope(a, b);
    const float slope_bc = slope(b, c);
    for (int row = first_row; row < end_row; ++row) {
      const float y = static_cast<float>(row) + 0.5F + bottom;
      const float across = a.x + (y - a.y) * slope_ac;
      const float other = y < b.y ? a.x + (y - a.y) * slope_ab : b.x + (y - b.y) * slope_bc;
      const int first = std::max(1, static_cast<int>(std::min(across, other) - left_edge + 0.5F));
      const int end =
          std::min(window_.width - 1, static_cast<int>(std::max(across, other) - left_edge + 0.5F));
      const std::size_t begin = index_of(0, row);
      const float at_row = a.rho + slope_y * (y - a.y) + slope_x * (left_edge + 0.5F - a.x);
      for (int column = first; column < end; ++column) {
        const float rho = std::clamp(at_row + slope_x * static_cast<float>(column), low, high);
        const std::size_t i = begin + static_cast<std::size_t>(column);
        greatest_[i] = std::max(greatest_[i], rho);
        least_[i] = std::min(least_[i], rho);
      }
      // How far matter begins from the centres beside the span, also where it covers none itself.
      const float left = std::min(across, other) - left_edge;
      const float right = std::max(across, other) - left_edge;
      float& before = gap_x_[begin + static_cast<std::size_t>(first - 1)];
      float& after = gap_x_[begin + static_cast<std::size_t>(end)];
      before = std::min(before, left - (static_cast<float>(first) - 0.5F));
      after = std::min(after, static_cast<float>(end) + 0.5F - right);
    }
    // The same along columns; here only the ends of the spans matter.
    if (b.x < a.x) std::swap(a, b);
    if (c.x < b.x) std::swap(b, c);
    if (b.x < a.x) std::swap(a, b);
    const int first_column = std::max(1, static_cast<int>(a.x - left_edge + 0.5F));
    const int end_column = std::min(window_.width - 1, static_cast<int>(c.x - left_edge + 0.5F));
    const auto tilt = [](const FieldPoint& from, const FieldPoint& to) {
      const float run = to.x - from.x;
      return run > 0.0F ? (to.y - from.y) / run : 0.0F;
    };
    const float tilt_ac = tilt(a, c);
    const float tilt_ab = tilt(a, b);
    const float tilt_bc = tilt(b, c);
    for (int column = first_column; column < end_column; ++column) {
      const float x = static_cast<float>(column) + 0.5F + left_edge;
      const float across = a.y + (x - a.x) * tilt_ac - bottom;
      const float other =
          (x < b.x ? a.y + (x - a.x) * tilt_ab : b.y + (x - b.x) * tilt_bc) - bottom;
      const float low_end = std::min(across, other);
      const float high_end = std::max(across, other);
      const int first = std::max(1, static_cast<int>(low_end + 0.5F));
      const int end = std::min(window_.height - 1, static_cast<int>(high_end + 0.5F));
      float& before = gap_y_[index_of(column, first - 1)];
      float& after = gap_y_[index_of(column, end)];
      before = std::min(before, low_end - (static_cast<float>(first) - 0.5F));
      after = std::min(after, static_cast<float>(end) + 0.5F - high_end);
    }
  }

  // Distance from the centre of an uncovered cell to the outline that passes beside it [cells];
  // half a cell where only a corner is near.
  [[nodiscard]] float gap(std::size_t i) const {
    const float x = gap_x_[i];
    const float y = gap_y_[i];
    if (x < kInfinity && y < kInfinity) {
      const float sum = x * x + y * y;
      return sum > 0.0F ? x * y / std::sqrt(sum) : 0.0F;
    }
    const float one = std::min(x, y);
    return one < kInfinity ? one : kHalfCell;
  }

  // sites_ -> min over all cells of squared distance + value, exactly, in place: one pass along
  // rows, one along columns, each the lower envelope of parabolas (Felzenszwalb and Huttenlocher,
  // "Distance Transforms of Sampled Functions").
  void transform() {
    const int width = window_.width;
    const int height = window_.height;
    turned_.resize(sites_.size());
    envelope_pass(sites_.data(), turned_.data(), width, height);
    envelope_pass(turned_.data(), sites_.data(), height, width);
  }

  // Each of `rows` rows of `length` values; the result is written transposed.
  void envelope_pass(const float* from, float* to, int length, int rows) {
    const auto n = static_cast<std::size_t>(length);
    const auto stride = static_cast<std::size_t>(rows);
    place_.resize(n);
    height_.resize(n);
    begins_.resize(n + 1);
    for (int row = 0; row < rows; ++row) {
      const float* values = from + static_cast<std::size_t>(row) * n;
      std::size_t count = 0;
      for (std::size_t q = 0; q < n; ++q) {
        if (values[q] == kInfinity) continue;
        const auto x = static_cast<float>(q);
        const float lifted = values[q] + x * x;
        float begin = -kInfinity;
        while (count > 0) {
          begin = (lifted - height_[count - 1]) / (2.0F * (x - place_[count - 1]));
          if (begin > begins_[count - 1]) break;
          --count;
          begin = -kInfinity;
        }
        place_[count] = x;
        height_[count] = lifted;
        begins_[count] = begin;
        ++count;
      }
      float* out = to + row;
      if (count == 0) {
        for (std::size_t q = 0; q < n; ++q) out[q * stride] = kInfinity;
        continue;
      }
      begins_[count] = kInfinity;
      std::size_t k = 0;
      for (std::size_t q = 0; q < n; ++q) {
        const auto x = static_cast<float>(q);
        while (begins_[k + 1] < x) ++k;
        // |x - p|^2 + f = x^2 - 2 x p + (p^2 + f)
        out[q * stride] = x * (x - 2.0F * place_[k]) + height_[k];
      }
    }
  }

  Window window_;
  std::vector<float> greatest_, least_;  // rho per cell; -1 and infinity where not covered
  std::vector<float> gap_x_, gap_y_;     // from centres to matter along row and column; infinity
  std::vector<float> sites_, turned_;
  std::vector<float> place_, height_, begins_;
};

// Vertex and face lists of each part.
struct PartFaces {
  std::vector<std::uint32_t> begin;    // per part, into indices
  std::vector<std::uint32_t> indices;  // of vertices, three per face
};

PartFaces faces_by_part(std::span<const CasterVertex> vertices,
                        std::span<const std::uint32_t> indices, std::span<const std::uint32_t> part,
                        std::size_t part_count) {
  PartFaces faces;
  faces.begin.assign(part_count + 1, 0);
  const auto part_of = [&](std::size_t i) -> std::size_t {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      if (indices[i + corner] >= vertices.size() || indices[i + corner] >= part.size()) {
        return part_count;
      }
    }
    return std::min<std::size_t>(part[indices[i]], part_count);
  };
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const std::size_t owner = part_of(i);
    if (owner < part_count) faces.begin[owner + 1] += 3;
  }
  std::partial_sum(faces.begin.begin(), faces.begin.end(), faces.begin.begin());
  faces.indices.resize(faces.begin.back());
  std::vector<std::uint32_t> fill(faces.begin.begin(), faces.begin.end() - 1);
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const std::size_t owner = part_of(i);
    if (owner >= part_count) continue;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      faces.indices[fill[owner]++] = indices[i + corner];
    }
  }
  return faces;
}

struct HeightBounds {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
};

// Projects clipped corners from the light of their part.
class LightProjection {
 public:
  LightProjection(const LayeredConstants& constants, const PartLight& light)
      : light_height_(constants.light_height),
        centre_(light.centre),
        radius_(std::isinf(constants.light_height) ? light.radius / constants.umbra_height
                                                   : light.radius * constants.light_ratio) {}

  [[nodiscard]] FieldPoint operator()(const CasterVertex& vertex) const {
    const double h = static_cast<double>(vertex.h);
    const double t = std::isinf(light_height_) ? 0.0 : h / (light_height_ - h);
    const double du = static_cast<double>(vertex.u) - centre_.x();
    const double dv = static_cast<double>(vertex.v) - centre_.y();
    return {static_cast<float>(static_cast<double>(vertex.u) + t * du),
            static_cast<float>(static_cast<double>(vertex.v) + t * dv),
            static_cast<float>(radius_ * (std::isinf(light_height_) ? h : t))};
  }

 private:
  double light_height_;
  Eigen::Vector2d centre_;
  double radius_;  // zenith: r_part / h_u, per metre of height; else a r_part, per t
};

}  // namespace

float ShadowField::sample(ShadowLayer which, const Eigen::Vector2d& p) const {
  const std::vector<float>& values = layer(which);
  const Eigen::Vector2d at = (p - origin) / cell - Eigen::Vector2d::Constant(0.5);
  const double column = std::floor(at.x());
  const double row = std::floor(at.y());
  if (!(column >= 0.0 && row >= 0.0 && column < width - 1 && row < height - 1)) return -1.0F;
  const std::size_t i = static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
                        static_cast<std::size_t>(column);
  const auto fx = static_cast<float>(at.x() - column);
  const auto fy = static_cast<float>(at.y() - row);
  const auto stride = static_cast<std::size_t>(width);
  const float low = values[i] + fx * (values[i + 1] - values[i]);
  const float high = values[i + stride] + fx * (values[i + stride + 1] - values[i + stride]);
  return low + fy * (high - low);
}

ShadowField power_distance_layers(std::span<const CasterVertex> vertices,
                                  std::span<const std::uint32_t> indices,
                                  std::span<const std::uint32_t> part,
                                  std::span<const PartLight> lights,
                                  const LayeredConstants& constants,
                                  const ShadowFieldOptions& options) {
  ShadowField field;
  const std::size_t part_count = lights.size();
  const PartFaces faces = faces_by_part(vertices, indices, part, part_count);
  const HeightRange range = layer_height_range(constants, ShadowLayer::middle);

  // Corners of all parts and levels, first in metres.
  struct Job {
    std::size_t begin, end;  // into points
    bool whole;
    std::array<float, 4> bounds;  // left, bottom, right, top, grown by rho
  };
  std::vector<FieldPoint> points;
  std::vector<Job> jobs;
  std::array<float, 4> all = {kInfinity, kInfinity, -kInfinity, -kInfinity};
  for (std::size_t p = 0; p < part_count; ++p) {
    const auto part_faces =
        std::span(faces.indices).subspan(faces.begin[p], faces.begin[p + 1] - faces.begin[p]);
    const LightProjection project(constants, lights[p]);
    std::vector<CasterVertex> corners = clip_to_heights(vertices, part_faces, range);
    if (corners.empty()) continue;
    HeightBounds heights;
    for (const CasterVertex& corner : corners) {
      heights.low = std::min(heights.low, static_cast<double>(corner.h));
      heights.high = std::max(heights.high, static_cast<double>(corner.h));
    }
    for (const double level : kLevels) {
      if (level < 1.0) {
        if (std::isinf(constants.light_height)) break;  // all outlines are of one size
        if (heights.high - heights.low <= 0.0) break;   // flat: all levels are the same
        const double top = heights.low + level * (heights.high - heights.low);
        std::vector<std::uint32_t> order(corners.size());
        std::iota(order.begin(), order.end(), 0U);
        corners = clip_to_heights(corners, order, {0.0, top});
        if (corners.empty()) break;
      }
      Job job = {points.size(), 0, level == 1.0, {kInfinity, kInfinity, -kInfinity, -kInfinity}};
      for (const CasterVertex& corner : corners) {
        const FieldPoint point = project(corner);
        points.push_back(point);
        job.bounds = {std::min(job.bounds[0], point.x - point.rho),
                      std::min(job.bounds[1], point.y - point.rho),
                      std::max(job.bounds[2], point.x + point.rho),
                      std::max(job.bounds[3], point.y + point.rho)};
      }
      job.end = points.size();
      // Nothing of this size casts on a table, and larger numbers would overflow.
      constexpr float kFar = 1e12F;  // [m]
      const bool near = job.bounds[0] > -kFar && job.bounds[1] > -kFar && job.bounds[2] < kFar &&
                        job.bounds[3] < kFar;
      if (!near) {
        points.resize(job.begin);
        continue;
      }
      all = {std::min(all[0], job.bounds[0]), std::min(all[1], job.bounds[1]),
             std::max(all[2], job.bounds[2]), std::max(all[3], job.bounds[3])};
      jobs.push_back(job);
    }
  }
  const float extent = std::max(all[2] - all[0], all[3] - all[1]);
  if (jobs.empty() || !(extent > 0.0F)) return field;

  constexpr int kMargin = 3;
  const float cell = extent / static_cast<float>(std::max(8, options.cells) - 2 * kMargin);
  if (!(cell > std::numeric_limits<float>::min())) return field;
  field.cell = static_cast<double>(cell);
  field.width = static_cast<int>(std::ceil((all[2] - all[0]) / cell)) + 2 * kMargin;
  field.height = static_cast<int>(std::ceil((all[3] - all[1]) / cell)) + 2 * kMargin;
  const float left = all[0] - static_cast<float>(kMargin) * cell;
  const float bottom = all[1] - static_cast<float>(kMargin) * cell;
  field.origin = {static_cast<double>(left), static_cast<double>(bottom)};
  const std::size_t count =
      static_cast<std::size_t>(field.width) * static_cast<std::size_t>(field.height);
  field.umbra.assign(count, -1e6F);
  field.middle.assign(count, -1.0F);
  field.penumbra.assign(count, -1e6F);

  for (FieldPoint& point : points) {
    point = {(point.x - left) / cell, (point.y - bottom) / cell, point.rho / cell};
  }
  PartField part_field;
  for (const Job& job : jobs) {
    const auto to_window = [&](float value, float from) {
      return static_cast<int>((value - from) / cell);
    };
    Window window;
    window.left = std::max(0, to_window(job.bounds[0], left) - 2);
    window.bottom = std::max(0, to_window(job.bounds[1], bottom) - 2);
    window.width = std::min(field.width, to_window(job.bounds[2], left) + 4) - window.left;
    window.height = std::min(field.height, to_window(job.bounds[3], bottom) + 4) - window.bottom;
    part_field.cover(std::span(points).subspan(job.begin, job.end - job.begin), window);
    const auto merge = [&](const std::vector<float>& values, std::vector<float>& into) {
      for (int row = 0; row < window.height; ++row) {
        const float* from =
            values.data() + static_cast<std::size_t>(row) * static_cast<std::size_t>(window.width);
        float* to =
            into.data() +
            static_cast<std::size_t>(row + window.bottom) * static_cast<std::size_t>(field.width) +
            static_cast<std::size_t>(window.left);
        for (int column = 0; column < window.width; ++column) {
          to[column] = std::max(to[column], from[column]);
        }
      }
    };
    if (job.whole) {
      merge(part_field.penumbra(), field.penumbra);
      merge(part_field.middle(), field.middle);
    }
    merge(part_field.umbra(), field.umbra);
  }
  return field;
}

std::vector<PlanePoint> field_triangles(const ShadowField& field, ShadowLayer layer) {
  std::vector<PlanePoint> triangles;
  const std::vector<float>& values = field.layer(layer);
  // Marching squares over the squares between four centres. A point on a side is computed from the
  // side's lower end, so that neighbours share it.
  struct Corner {
    int column, row;
    float value;
  };
  const auto position = [&field](double column, double row) {
    return PlanePoint{static_cast<float>(field.origin.x() + field.cell * (column + 0.5)),
                      static_cast<float>(field.origin.y() + field.cell * (row + 0.5))};
  };
  const auto crossing = [&](Corner a, Corner b) {
    if (b.row < a.row || (b.row == a.row && b.column < a.column)) std::swap(a, b);
    const double t = static_cast<double>(a.value) /
                     (static_cast<double>(a.value) - static_cast<double>(b.value));
    return position(a.column + t * (b.column - a.column), a.row + t * (b.row - a.row));
  };
  for (int row = 0; row + 1 < field.height; ++row) {
    for (int column = 0; column + 1 < field.width; ++column) {
      const std::size_t i = static_cast<std::size_t>(row) * static_cast<std::size_t>(field.width) +
                            static_cast<std::size_t>(column);
      const auto stride = static_cast<std::size_t>(field.width);
      const std::array<Corner, 4> corners = {Corner{column, row, values[i]},
                                             Corner{column + 1, row, values[i + 1]},
                                             Corner{column + 1, row + 1, values[i + stride + 1]},
                                             Corner{column, row + 1, values[i + stride]}};
      std::array<PlanePoint, 8> polygon;
      std::size_t count = 0;
      for (std::size_t c = 0; c < 4; ++c) {
        const Corner& from = corners[c];
        const Corner& to = corners[(c + 1) % 4];
        if (from.value > 0.0F) polygon[count++] = position(from.column, from.row);
        if ((from.value > 0.0F) != (to.value > 0.0F)) polygon[count++] = crossing(from, to);
      }
      for (std::size_t c = 2; c < count; ++c) {
        triangles.insert(triangles.end(), {polygon[0], polygon[c - 1], polygon[c]});
      }
    }
  }
  return triangles;
}

}  // namespace penumbra
