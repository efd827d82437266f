#include "tracking/alignment/pattern_renderer.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <random>
#include <thread>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {
namespace {

struct Sheet {
  TagPattern pattern;
  Transform<frame::Table, frame::Tag> T_table_tag;
  std::string group;
  double cell_m = 0.0;
  double size_m = 0.0;
  TagCurvature curvature;

  // Returns the height of the paper over the tag's plane at a point from the tag's centre [cells].
  [[nodiscard]] double height(const Eigen::Vector2d& from_centre) const {
    return curvature.height(from_centre.x() * cell_m, from_centre.y() * cell_m, size_m) / cell_m;
  }
};

// Iterations that find the paper on a ray. Each reduces the error by the paper's slope over the
// ray's.
constexpr int kPaperIterations = 12;

// Points of a tag's lattice [cells], or offsets [px].
struct Points {
  std::vector<double> a;
  std::vector<double> b;

  void resize(std::size_t count) {
    a.resize(count);
    b.resize(count);
  }
};

// One tag as viewed from one camera pose.
struct View {
  // (A, B, S) = matrix * (x, y, 1); a = A / S, b = B / S, depth = 1 / S.
  Eigen::Matrix3d lattice_from_ray;
  Eigen::AlignedBox2d box;  // pixels that the tag may cover
  Eigen::Vector3d camera;   // camera centre, lattice frame [cells]

  // Returns the point of the paper on the ray through the point `ab` of the lattice.
  [[nodiscard]] Eigen::Vector2d on_paper(const Sheet& sheet, const Eigen::Vector2d& ab) const {
    if (sheet.curvature.is_flat()) return ab;
    const double half = 0.5 * sheet.pattern.total_width();
    Eigen::Vector2d point = ab;
    for (int i = 0; i < kPaperIterations; ++i) {
      const double height = sheet.height(point - Eigen::Vector2d(half, half));
      point = ab - height / camera.z() * (ab - camera.head<2>());
    }
    return point;
  }

  // Finds the points of the paper on the rays xy + d_xy_d_pixel * offset; (-1, -1) behind the
  // camera. Like on_paper(), but the compiler vectorizes the loops.
  void find_points(const Sheet& sheet, const Eigen::Vector2d& xy,
                   const Eigen::Matrix2d& d_xy_d_pixel, const Points& offsets, Points& flat,
                   Points& points) const {
    const Eigen::Matrix3d& M = lattice_from_ray;
    const std::size_t count = offsets.a.size();
    for (std::size_t s = 0; s < count; ++s) {
      const double x =
          xy.x() + (d_xy_d_pixel(0, 0) * offsets.a[s] + d_xy_d_pixel(0, 1) * offsets.b[s]);
      const double y =
          xy.y() + (d_xy_d_pixel(1, 0) * offsets.a[s] + d_xy_d_pixel(1, 1) * offsets.b[s]);
      const double depth = M(2, 0) * x + (M(2, 1) * y + M(2, 2));
      flat.a[s] = depth > 0.0 ? (M(0, 0) * x + (M(0, 1) * y + M(0, 2))) / depth : -1.0;
      flat.b[s] = depth > 0.0 ? (M(1, 0) * x + (M(1, 1) * y + M(1, 2))) / depth : -1.0;
    }
    points = flat;
    if (sheet.curvature.is_flat()) return;
    const double half = 0.5 * sheet.pattern.total_width();
    for (int i = 0; i < kPaperIterations; ++i) {
      for (std::size_t s = 0; s < count; ++s) {
        const double height = sheet.height({points.a[s] - half, points.b[s] - half});
        points.a[s] = flat.a[s] - height / camera.z() * (flat.a[s] - camera.x());
        points.b[s] = flat.b[s] - height / camera.z() * (flat.b[s] - camera.y());
      }
    }
  }
};

// Light of a tag's cells, surrounded by a row and a column of the background's.
class CellLight {
 public:
  CellLight(const TagPattern& pattern, const PatternRenderOptions& options)
      : width_(pattern.total_width()),
        covered_to_(options.covered_fraction * width_),
        cover_(options.cover),
        light_(static_cast<std::size_t>((width_ + 2) * (width_ + 2)), options.background) {
    for (int j = 0; j < width_; ++j) {
      for (int i = 0; i < width_; ++i)
        light_[index(i + 1, j + 1)] = pattern.white(i, j) ? options.white : options.black;
    }
  }

  // Returns the sum over the points.
  [[nodiscard]] double sum(const Points& points) const {
    double sum = 0.0;
    for (std::size_t s = 0; s < points.a.size(); ++s) {
      const double a = within(points.a[s]);
      const double b = within(points.b[s]);
      const bool covered = a >= 0.0 && a < covered_to_ && b >= 0.0 && b < width_;
      sum += covered ? cover_ : light_[index(static_cast<int>(a + 1.0), static_cast<int>(b + 1.0))];
    }
    return sum;
  }

 private:
  // Returns a coordinate in [-1, width]. Not a number becomes -1.
  [[nodiscard]] double within(double a) const {
    return std::min(std::max(-1.0, a), static_cast<double>(width_));
  }
  [[nodiscard]] std::size_t index(int i, int j) const {
    return static_cast<std::size_t>(j * (width_ + 2) + i);
  }
  int width_;
  double covered_to_;
  double cover_;
  std::vector<double> light_;
};

// Returns the fractional part of k * step; an irrational step fills [0, 1) evenly.
double scattered(int k, double step) {
  const double value = k * step;
  return value - std::floor(value);
}

// Distribution function of the point spread along one axis: the lens' Gaussian * the pixel's box.
double spread_cdf(double x, double sigma) {
  const auto integral = [sigma](double z) {  // antiderivative of the normal distribution function
    if (sigma < 1e-6) return std::max(z, 0.0);
    const double t = z / sigma;
    return z * 0.5 * std::erfc(-t / std::numbers::sqrt2) +
           sigma * std::exp(-0.5 * t * t) / std::sqrt(2.0 * std::numbers::pi);
  };
  return integral(x + 0.5) - integral(x - 0.5);
}

// Inverse of spread_cdf, by bisection.
double spread_quantile(double share, double sigma) {
  double low = -0.5 - 9.0 * sigma;
  double high = -low;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (spread_cdf(middle, sigma) < share ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

// Returns sub-pixel offsets distributed as the point spread: quantiles of a golden-ratio lattice.
std::vector<Eigen::Vector2d> make_offsets(int count, double sigma) {
  std::vector<Eigen::Vector2d> offsets;
  offsets.reserve(static_cast<std::size_t>(count));
  for (int k = 0; k < count; ++k) {
    offsets.emplace_back(
        spread_quantile((k + 0.5) / count, sigma),
        spread_quantile(scattered(k, std::numbers::phi) * (count - 1.0) / count + 0.5 / count,
                        sigma));
  }
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& offset : offsets) mean += offset;
  mean /= count;
  for (Eigen::Vector2d& offset : offsets) offset -= mean;  // removes the bias of a finite point set
  return offsets;
}

// Gaussian noise that is reproducible on every machine, unlike std::normal_distribution.
class Noise {
 public:
  explicit Noise(std::uint64_t seed) : engine_(seed) {}
  double operator()() {
    if (has_spare_) {
      has_spare_ = false;
      return spare_;
    }
    const double u1 = (static_cast<double>(engine_() >> 11) + 0.5) * 0x1.0p-53;
    const double u2 = (static_cast<double>(engine_() >> 11) + 0.5) * 0x1.0p-53;
    const double radius = std::sqrt(-2.0 * std::log(u1));
    spare_ = radius * std::sin(2.0 * std::numbers::pi * u2);
    has_spare_ = true;
    return radius * std::cos(2.0 * std::numbers::pi * u2);
  }

 private:
  std::mt19937_64 engine_;
  double spare_ = 0.0;
  bool has_spare_ = false;
};

}  // namespace

void add_noise(std::span<std::uint8_t> rgba, double sigma_grey, std::uint64_t seed) {
  if (!(sigma_grey > 0.0)) return;
  Noise noise(seed);
  for (std::size_t i = 0; i < rgba.size(); ++i) {
    if (i % 4 == 3) continue;
    rgba[i] = static_cast<std::uint8_t>(
        std::lround(std::clamp(rgba[i] + sigma_grey * noise(), 0.0, 255.0)));
  }
}

struct PatternRenderer::Impl {
  CameraModel camera;
  std::vector<Sheet> sheets;
  // Ray of each pixel's centre and d ray / d pixel, computed on demand.
  struct PixelRay {
    Eigen::Vector2d xy{std::numeric_limits<double>::quiet_NaN(), 0.0};
    Eigen::Matrix2d d_xy_d_pixel;
    bool valid = false;
    bool known = false;
  };
  std::vector<PixelRay> rays;

  const PixelRay& ray(int x, int y) {
    PixelRay& r = rays[static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width()) +
                       static_cast<std::size_t>(x)];
    if (!r.known) {
      r.known = true;
      if (const auto direction = camera.unproject({x, y})) {
        r.xy = direction->head<2>();
        const Eigen::Matrix2d d_pixel_d_xy =
            Eigen::Vector2d(camera.parameters().fx, camera.parameters().fy).asDiagonal() *
            camera.distortion_jacobian(r.xy);
        r.valid = std::abs(d_pixel_d_xy.determinant()) > 1e-9;
        if (r.valid) r.d_xy_d_pixel = d_pixel_d_xy.inverse();
      }
    }
    return r;
  }

  // Returns nullopt if the tag faces away or is completely outside the image.
  std::optional<View> view_of(const Sheet& sheet, const CameraPose& T_table_camera,
                              const Transform<frame::Table, frame::Tag>& T_table_tag,
                              double margin_px) const {
    const auto T_camera_tag = T_table_camera.inverse() * T_table_tag;
    const Eigen::Matrix3d R = T_camera_tag.rotation_matrix();
    if (R.col(2).dot(T_camera_tag.translation()) >= 0.0) return std::nullopt;
    const double half = 0.5 * sheet.pattern.total_width();
    Eigen::Matrix3d ray_from_lattice;
    ray_from_lattice.col(0) = R.col(0) * sheet.cell_m;
    ray_from_lattice.col(1) = R.col(1) * sheet.cell_m;
    ray_from_lattice.col(2) =
        T_camera_tag.translation() - half * sheet.cell_m * (R.col(0) + R.col(1));
    View view;
    view.lattice_from_ray = ray_from_lattice.inverse();
    view.camera = -(R.transpose() * T_camera_tag.translation()) / sheet.cell_m +
                  Eigen::Vector3d(half, half, 0.0);
    // Samples the outline, which is curved by distortion.
    const Eigen::AlignedBox2d image(Eigen::Vector2d::Zero(),
                                    Eigen::Vector2d(camera.width(), camera.height()));
    bool whole_image = false;
    constexpr int kSteps = 8;
    for (int i = 0; i <= kSteps; ++i) {
      for (int j = 0; j <= kSteps; ++j) {
        const Eigen::Vector3d p = ray_from_lattice * Eigen::Vector3d(2.0 * half * i / kSteps,
                                                                     2.0 * half * j / kSteps, 1.0);
        const auto pixel = camera.project(p);
        whole_image = whole_image || !pixel;
        if (pixel) view.box.extend(*pixel);
      }
    }
    if (whole_image) view.box = image;
    const Eigen::Vector2d& low = view.box.min();
    const Eigen::Vector2d& high = view.box.max();
    const double extra = margin_px + 0.05 * (high.x() - low.x() + high.y() - low.y());
    view.box.min().array() -= extra;
    view.box.max().array() += extra;
    if (!view.box.intersects(image)) return std::nullopt;
    return view;
  }
};

PatternRenderer::PatternRenderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PatternRenderer::PatternRenderer(PatternRenderer&&) noexcept = default;
PatternRenderer::~PatternRenderer() = default;

Result<PatternRenderer> PatternRenderer::create(const CameraModel& camera,
                                                std::span<const MappedTag> tags) {
  auto impl = std::make_unique<Impl>();
  impl->camera = camera;
  for (const MappedTag& tag : tags) {
    PENUMBRA_TRY(TagPattern pattern, TagPattern::make(tag.family, tag.id));
    const double cell_m = tag.size_m / pattern.width_at_border();
    impl->sheets.push_back(
        {std::move(pattern), tag.T_table_tag, tag.group, cell_m, tag.size_m, tag.curvature});
  }
  impl->rays.resize(static_cast<std::size_t>(camera.width()) *
                    static_cast<std::size_t>(camera.height()));
  return PatternRenderer(std::move(impl));
}

std::vector<double> PatternRenderer::render_light(std::span<const CameraPose> path,
                                                  const PatternRenderOptions& options,
                                                  std::span<const GroupPlacement> placements) {
  PENUMBRA_ASSERT(!path.empty() && options.samples > 0);
  const int width = impl_->camera.width();
  const int height = impl_->camera.height();
  const auto at = [width](int x, int y) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
           static_cast<std::size_t>(x);
  };
  std::vector<double> light(at(0, height), options.background * options.gain);

  const std::vector<Eigen::Vector2d> offsets = make_offsets(options.samples, options.lens_blur_px);
  Points split_offsets;
  for (const Eigen::Vector2d& offset : offsets) {
    split_offsets.a.push_back(offset.x());
    split_offsets.b.push_back(offset.y());
  }
  // Index into `path` of each sub-sample, independent of its offset.
  std::vector<std::size_t> times(offsets.size());
  for (std::size_t s = 0; s < times.size(); ++s) {
    times[s] =
        std::min(path.size() - 1,
                 static_cast<std::size_t>(scattered(static_cast<int>(s), std::numbers::sqrt2) *
                                          static_cast<double>(path.size())));
  }
  double reach_px = 0.0;
  for (const Eigen::Vector2d& offset : offsets) reach_px = std::max(reach_px, offset.norm());

  // views[tag * path.size() + time]
  std::vector<std::optional<View>> views;
  std::vector<std::vector<int>> rows(static_cast<std::size_t>(height));  // tags in each row
  std::vector<Eigen::AlignedBox2i> boxes(impl_->sheets.size());
  std::vector<CellLight> cell_light;
  const Eigen::Array2d image_size(width, height);
  for (std::size_t k = 0; k < impl_->sheets.size(); ++k) {
    const Sheet& sheet = impl_->sheets[k];
    cell_light.emplace_back(sheet.pattern, options);
    Eigen::AlignedBox2i& box = boxes[k];
    for (std::size_t time = 0; time < path.size(); ++time) {
      Transform<frame::Table, frame::Tag> T_table_tag = sheet.T_table_tag;
      for (const GroupPlacement& placement : placements) {
        if (placement.group != sheet.group) continue;
        PENUMBRA_ASSERT(placement.path.empty() || placement.path.size() == path.size());
        const Transform<frame::Group, frame::Tag> T_group_tag(sheet.T_table_tag.rotation(),
                                                              sheet.T_table_tag.translation());
        T_table_tag =
            (placement.path.empty() ? placement.T_table_group : placement.path[time]) * T_group_tag;
      }
      views.push_back(impl_->view_of(sheet, path[time], T_table_tag, reach_px + 2.0));
      if (const auto& view = views.back()) {
        const Eigen::Array2d low = view->box.min().array().floor().max(0.0).min(image_size);
        const Eigen::Array2d high = view->box.max().array().ceil().max(0.0).min(image_size - 1.0);
        box.min() = box.min().cwiseMin(low.cast<int>().matrix());
        box.max() = box.max().cwiseMax(high.cast<int>().matrix());
      }
    }
    for (int y = box.min().y(); y <= box.max().y(); ++y)
      rows[static_cast<std::size_t>(y)].push_back(static_cast<int>(k));
  }

  // Returns the light of the nearest tag's cell on a ray at one time, or the background's.
  const auto light_at = [&](const std::vector<int>& candidates, std::size_t time,
                            const Eigen::Vector2d& xy) {
    double nearest = 0.0;  // 1 / depth
    double value = options.background;
    for (const int k : candidates) {
      const auto& view = views[static_cast<std::size_t>(k) * path.size() + time];
      if (!view) continue;
      const Eigen::Vector3d h = view->lattice_from_ray * Eigen::Vector3d(xy.x(), xy.y(), 1.0);
      if (h.z() <= nearest) continue;
      const Sheet& sheet = impl_->sheets[static_cast<std::size_t>(k)];
      const Eigen::Vector2d ab = view->on_paper(sheet, h.head<2>() / h.z());
      const double a = ab.x();
      const double b = ab.y();
      const TagPattern& pattern = sheet.pattern;
      const double size = pattern.total_width();
      if (!(a >= 0.0 && b >= 0.0 && a < size && b < size)) continue;
      nearest = h.z();
      value =
          pattern.white(static_cast<int>(a), static_cast<int>(b)) ? options.white : options.black;
      if (a < options.covered_fraction * size) value = options.cover;
    }
    return value;
  };

  struct Scratch {
    std::vector<int> candidates;
    Points flat, points;
  };
  // Returns the sum of the sub-samples' light if only one tag is near.
  const auto sum_of_tag = [&](int k, const Impl::PixelRay& ray, Scratch& scratch) {
    const Sheet& sheet = impl_->sheets[static_cast<std::size_t>(k)];
    const std::size_t first_view = static_cast<std::size_t>(k) * path.size();
    Points& points = scratch.points;
    points.resize(offsets.size());
    scratch.flat.resize(offsets.size());
    if (const auto& view = views[first_view]; path.size() == 1 && view) {
      view->find_points(sheet, ray.xy, ray.d_xy_d_pixel, split_offsets, scratch.flat, points);
    } else {
      for (std::size_t s = 0; s < offsets.size(); ++s) {
        Eigen::Vector2d point(-1.0, -1.0);  // beside the tag
        if (const auto& now = views[first_view + times[s]]) {
          const Eigen::Vector2d xy = ray.xy + ray.d_xy_d_pixel * offsets[s];
          const Eigen::Vector3d h = now->lattice_from_ray * Eigen::Vector3d(xy.x(), xy.y(), 1.0);
          if (h.z() > 0.0) point = now->on_paper(sheet, h.head<2>() / h.z());
        }
        points.a[s] = point.x();
        points.b[s] = point.y();
      }
    }
    return cell_light[static_cast<std::size_t>(k)].sum(points);
  };

  // Returns the cells of a tag that the sub-samples of a pixel may show, or nullopt if unknown.
  struct Cells {
    Eigen::Vector2d low, high;
    bool unseen = false;  // at some time
  };
  const auto cells_near = [&](int k, const Impl::PixelRay& ray) -> std::optional<Cells> {
    const Sheet& sheet = impl_->sheets[static_cast<std::size_t>(k)];
    // The paper's slope changes the density of pixels on it.
    const double margin = sheet.curvature.is_flat() ? 1.2 : 2.0;
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    Cells cells{Eigen::Vector2d::Constant(kInfinity), Eigen::Vector2d::Constant(-kInfinity)};
    for (std::size_t time = 0; time < path.size(); ++time) {
      const auto& view = views[static_cast<std::size_t>(k) * path.size() + time];
      if (!view) {
        cells.unseen = true;
        continue;
      }
      const Eigen::Vector3d h =
          view->lattice_from_ray * Eigen::Vector3d(ray.xy.x(), ray.xy.y(), 1.0);
      if (h.z() <= 0.0) return std::nullopt;
      const Eigen::Vector2d ab = h.head<2>() / h.z();
      const Eigen::Matrix2d d_ab_d_pixel = (view->lattice_from_ray.topLeftCorner<2, 2>() -
                                            ab * view->lattice_from_ray.bottomLeftCorner<1, 2>()) /
                                           h.z() * ray.d_xy_d_pixel;
      const Eigen::Vector2d reach = margin * reach_px * d_ab_d_pixel.rowwise().norm();
      const Eigen::Vector2d point = view->on_paper(sheet, ab);
      cells.low = cells.low.cwiseMin(point - reach);
      cells.high = cells.high.cwiseMax(point + reach);
    }
    return cells;
  };
  const auto is_beside = [&](int k, const Cells& cells) {
    const double size = impl_->sheets[static_cast<std::size_t>(k)].pattern.total_width();
    return !(cells.high.minCoeff() >= 0.0 && cells.low.maxCoeff() < size);
  };

  // Returns the light of a pixel if all sub-samples certainly have the same light, else nullopt.
  const auto uniform_light = [&](int k, const Cells& cells) -> std::optional<double> {
    if (options.covered_fraction > 0.0) return std::nullopt;
    const TagPattern& pattern = impl_->sheets[static_cast<std::size_t>(k)].pattern;
    const Eigen::Vector2d &low = cells.low, &high = cells.high;
    if (cells.unseen || !(low.minCoeff() >= 0.0 && high.maxCoeff() < pattern.total_width()))
      return std::nullopt;
    const bool white = pattern.white(static_cast<int>(low.x()), static_cast<int>(low.y()));
    for (int j = static_cast<int>(low.y()); j <= static_cast<int>(high.y()); ++j) {
      for (int i = static_cast<int>(low.x()); i <= static_cast<int>(high.x()); ++i) {
        if (pattern.white(i, j) != white) return std::nullopt;
      }
    }
    return white ? options.white : options.black;
  };

  const auto render_row = [&](int y, Scratch& scratch) {
    const std::vector<int>& in_row = rows[static_cast<std::size_t>(y)];
    std::vector<int>& candidates = scratch.candidates;
    for (int x = 0; x < width && !in_row.empty(); ++x) {
      candidates.clear();
      std::optional<Cells> cells;  // of the last candidate
      for (const int k : in_row) {
        const Eigen::AlignedBox2i& box = boxes[static_cast<std::size_t>(k)];
        if (x < box.min().x() || x > box.max().x()) continue;
        const Impl::PixelRay& ray = impl_->ray(x, y);
        if (!ray.valid) break;
        const std::optional<Cells> near = cells_near(k, ray);
        if (near && is_beside(k, *near)) continue;
        candidates.push_back(k);
        cells = near;
      }
      if (candidates.empty()) continue;
      const Impl::PixelRay& ray = impl_->ray(x, y);
      std::optional<double> uniform;
      if (candidates.size() == 1 && cells) uniform = uniform_light(candidates.front(), *cells);
      double sum = 0.0;
      if (uniform) {
        light[at(x, y)] = options.gain * *uniform;
        continue;
      } else if (candidates.size() == 1) {
        sum = sum_of_tag(candidates.front(), ray, scratch);
      } else {
        for (std::size_t s = 0; s < offsets.size(); ++s)
          sum += light_at(candidates, times[s], ray.xy + ray.d_xy_d_pixel * offsets[s]);
      }
      light[at(x, y)] = options.gain * sum / static_cast<double>(offsets.size());
    }
  };
  // Rows are independent.
  const int threads = std::clamp(options.threads, 1, height);
  const auto render_rows = [&](int first) {
    Scratch scratch;
    for (int y = first; y < height; y += threads) {
      if (y >= options.first_row && y < options.end_row) render_row(y, scratch);
    }
  };
  std::vector<std::jthread> helpers;
  for (int k = 1; k < threads; ++k) helpers.emplace_back(render_rows, k);
  render_rows(0);
  helpers.clear();  // joins the threads

  return light;
}

GreyImage PatternRenderer::render(std::span<const CameraPose> path,
                                  const PatternRenderOptions& options,
                                  std::span<const GroupPlacement> placements) {
  PENUMBRA_ASSERT(options.gamma > 0.0);
  const std::vector<double> light = render_light(path, options, placements);
  GreyImage image;
  image.width = impl_->camera.width();
  image.height = impl_->camera.height();
  // Most pixels have the light of the pixel before them.
  double known_linear = std::numeric_limits<double>::quiet_NaN();
  double known_grey = 0.0;
  const auto grey_of = [&](double linear) {
    if (linear != known_linear) {
      known_linear = linear;
      known_grey = 255.0 * std::pow(std::clamp(linear, 0.0, 1.0), 1.0 / options.gamma);
    }
    return known_grey;
  };
  image.pixels.assign(light.size(), static_cast<std::uint8_t>(
                                        std::lround(grey_of(options.background * options.gain))));
  Noise noise(options.seed);
  const auto width = static_cast<std::size_t>(image.width);
  const auto first = static_cast<std::size_t>(std::clamp(options.first_row, 0, image.height));
  const auto end = static_cast<std::size_t>(std::clamp(options.end_row, 0, image.height));
  for (std::size_t i = first * width; i < end * width; ++i) {
    const double grey =
        grey_of(light[i]) + (options.noise_grey > 0.0 ? options.noise_grey * noise() : 0.0);
    image.pixels[i] = static_cast<std::uint8_t>(std::lround(std::clamp(grey, 0.0, 255.0)));
  }
  return image;
}

}  // namespace penumbra
