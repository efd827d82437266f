#include "tracking/tag_alignment.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "core/assert.hpp"
#include "tracking/alignment_kernel.hpp"
#include "tracking/tag_pattern.hpp"

namespace penumbra {
namespace {

constexpr int kSearchReach = 31;          // [px] the code search looks this far to each side
constexpr int kSearchPoints = 256;        // in all
constexpr int kMaxSearchCells = 36;       // per tag; sums of so many bytes fit in 16 bits
constexpr double kCornerMoved_px = 0.25;  // a fine stage that moved the tags by more is repeated
constexpr double kConverged_px = 0.03;    // the step after such a one is below a hundredth
constexpr int kFineRounds = 3;
constexpr int kFineSteps = 5;        // per round at most
constexpr double kFineCutoff = 0.6;  // of Tukey's weights, as a share of the gain

// What to ask for so that so many of the kernel's blocks come out full: the walk along the edges
// meets its cap within some samples, and a last one over the brim costs a whole block.
constexpr int filled_blocks(int blocks) {
  return (kernel::kBlock - 4) * blocks;
}

// 64-byte aligned arrays of floats, one behind the other.
class SampleStorage {
 public:
  void resize(int capacity) {
    capacity = (capacity + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
    if (capacity <= capacity_) return;
    capacity_ = capacity + capacity / 2;
    capacity_ = (capacity_ + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
    data_.assign(static_cast<std::size_t>(capacity_) * kArrays + 16, 0.0F);
    vertex_.assign(static_cast<std::size_t>(capacity_), 0);
  }
  [[nodiscard]] int capacity() const { return capacity_; }
  [[nodiscard]] kernel::Samples view() {
    auto address = reinterpret_cast<std::uintptr_t>(data_.data());
    float* next = data_.data() + ((64 - address % 64) % 64) / sizeof(float);
    const auto take = [&] {
      float* array = next;
      next += capacity_;
      return array;
    };
    kernel::Samples s;
    for (float** array : {&s.pixel_x, &s.pixel_y, &s.ray_x, &s.ray_y, &s.value, &s.weight, &s.va,
                          &s.vb, &s.ka, &s.kb, &s.rho, &s.model, &s.residual})
      *array = take();
    for (float*& array : s.c) array = take();
    s.vertex = vertex_.data();
    return s;
  }

 private:
  static constexpr std::size_t kArrays = 29;
  std::vector<float> data_;
  std::vector<std::int32_t> vertex_;
  int capacity_ = 0;
};

struct Tag {
  TagPattern pattern;
  Transform<frame::Table, frame::Tag> T_table_tag;
  double cell_m = 0.0;
  int side = 0;  // lattice vertices per side
  std::vector<float> lattice_a, lattice_b;
  // Of each vertex for 1, 2 and 3 lines per axis, see kernel::Samples.
  std::vector<std::array<float, 4>> coefficients1;
  std::vector<std::array<float, 16>> coefficients2, coefficients3;
  std::vector<DataCell> search_cells;  // as many white as black, the white ones first
  int search_white = 0;

  // Of the current frame.
  bool visible = false;
  Eigen::Matrix3d R_lattice_camera = Eigen::Matrix3d::Identity();
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of the camera in the lattice [cells]
  Eigen::Matrix3d ray_from_lattice = Eigen::Matrix3d::Identity();
  std::array<float, 9> lattice_from_ray{};
  std::vector<float> ray_x, ray_y, pixel_x, pixel_y, depth, ka, kb, rho;  // of the vertices
  double cell_px = 0.0;  // the smaller side of the central cell, across it
  double cell_max_px = 0.0;
  double correlation = 0.0;
  Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();
  double gain = 0.0, offset = 0.0;
  int reach = 1;
  bool correlated = false;
  SampleStorage storage;
  kernel::Samples samples;
  int used = 0;  // samples without padding
  // Of the last selection: a run's samples end where the next begin.
  struct RunSamples {
    int end = 0;
    bool vertical = false;
  };
  std::vector<RunSamples> run_samples;
  kernel::Sums sums;
  std::vector<std::int16_t> scores;
  int score_points = 0;
  TagAlignment result;
};

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

// floor of |x| < 2^20, without a call.
int floor_of(double x) {
  constexpr int kShift = 1 << 20;
  return static_cast<int>(x + kShift) - kShift;
}

int ceil_of(double x) {
  return -floor_of(-x);
}

// A tag's gain and offset, solved for in terms of the pose.
struct Eliminated {
  Eigen::Matrix<double, 6, 2> cross;  // lattice frame
  Eigen::Matrix2d inverse;
  Eigen::Vector2d gradient;
  Matrix6d adjoint;  // from the camera's motion to the lattice's
  bool valid = false;
};

// Places along the rows across an edge that are sampled, in pixels from the edge's own pixel.
struct Band {
  std::array<int, 16> offsets{};
  int count = 0;
};

}  // namespace

Eigen::Isometry3d exp_se3(const Vector6d& xi) {
  const Eigen::Vector3d nu = xi.head<3>();
  const Eigen::Vector3d omega = xi.tail<3>();
  const double angle = omega.norm();
  const Eigen::Matrix3d W = skew(omega);
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d V = Eigen::Matrix3d::Identity();
  if (angle < 1e-6) {
    R += W + 0.5 * W * W;
    V += 0.5 * W + W * W / 6.0;
  } else {
    const double a2 = angle * angle;
    R += std::sin(angle) / angle * W + (1.0 - std::cos(angle)) / a2 * W * W;
    V += (1.0 - std::cos(angle)) / a2 * W + (angle - std::sin(angle)) / (a2 * angle) * W * W;
  }
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = R;
  T.translation() = V * nu;
  return T;
}

Vector6d log_se3(const Eigen::Isometry3d& T) {
  Eigen::Quaterniond q(T.linear());
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const double s = q.vec().norm();
  const double angle = 2.0 * std::atan2(s, q.w());
  const Eigen::Vector3d omega =
      s < 1e-12 ? Eigen::Vector3d(2.0 * q.vec()) : Eigen::Vector3d(q.vec() * (angle / s));
  const Eigen::Matrix3d W = skew(omega);
  Eigen::Matrix3d V_inverse = Eigen::Matrix3d::Identity() - 0.5 * W;
  if (angle < 1e-4) {
    V_inverse += W * W / 12.0;
  } else {
    V_inverse +=
        (1.0 / (angle * angle) - (1.0 + std::cos(angle)) / (2.0 * angle * std::sin(angle))) * W * W;
  }
  Vector6d xi;
  xi.head<3>() = V_inverse * T.translation();
  xi.tail<3>() = omega;
  return xi;
}

struct TagAligner::Impl {
  CameraModel camera;
  AlignmentOptions options;
  const kernel::Variant* kernel = nullptr;
  kernel::Lens lens;
  std::array<float, 256> tone{};
  std::vector<Tag> tags;
  std::vector<Tag*> active;
  AlignmentResult result;
  // Of the current frame.
  ImageView image;
  Eigen::Isometry3d T_camera_table = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_predicted = Eigen::Isometry3d::Identity();
  Matrix6d prior_information = Matrix6d::Zero();
  Matrix6d prior_covariance = Matrix6d::Zero();
  double extra_blur_px = 0.0;
  double variance = 0.0;     // of a residual [grey^2]
  double noise_share = 0.0;  // sigma of a residual over the gain, by the median; 0: unknown
  Matrix6d information = Matrix6d::Zero();
  std::vector<Eliminated> eliminated;  // of the last step, by place in `active`
  std::vector<std::int32_t> score_sum;
  std::vector<std::uint8_t> search_scratch;

  void set_tone(double exponent) {
    options.tone_exponent = exponent;
    for (int i = 0; i < 256; ++i)
      tone[static_cast<std::size_t>(i)] = static_cast<float>(255.0 * std::pow(i / 255.0, exponent));
  }

  // --- geometry of one tag at the current pose
  void place(Tag& tag) const {
    const Eigen::Isometry3d T_table_tag =
        Eigen::Translation3d(tag.T_table_tag.translation()) * tag.T_table_tag.rotation();
    const Eigen::Isometry3d T = T_camera_table * T_table_tag;
    const double half = 0.5 * (tag.side - 1);
    const Eigen::Matrix3d R = T.linear();
    tag.ray_from_lattice.col(0) = R.col(0) * tag.cell_m;
    tag.ray_from_lattice.col(1) = R.col(1) * tag.cell_m;
    tag.ray_from_lattice.col(2) = T.translation() - half * tag.cell_m * (R.col(0) + R.col(1));
    tag.R_lattice_camera = R.transpose();
    tag.centre = -(R.transpose() * T.translation()) / tag.cell_m + Eigen::Vector3d(half, half, 0.0);
    const Eigen::Matrix3d inverse = tag.ray_from_lattice.inverse() * tag.cell_m;  // S near 1
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c)
        tag.lattice_from_ray[static_cast<std::size_t>(3 * r + c)] =
            static_cast<float>(inverse(r, c));
    }
  }

  // `added_variance_px2` blurs the model beyond what the lens does.
  void project_lattice(Tag& tag, double added_variance_px2) const {
    std::array<float, 9> M{};
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c)
        M[static_cast<std::size_t>(3 * r + c)] = static_cast<float>(tag.ray_from_lattice(r, c));
    }
    kernel::Blur blur;
    blur.variance_px2 = static_cast<float>(options.blur_px * options.blur_px + added_variance_px2);
    blur.motion_x_px = static_cast<float>(tag.motion_px.x());
    blur.motion_y_px = static_cast<float>(tag.motion_px.y());
    kernel::Vertices vertices;
    vertices.count = static_cast<int>(tag.lattice_a.size());
    vertices.a = tag.lattice_a.data();
    vertices.b = tag.lattice_b.data();
    vertices.ray_x = tag.ray_x.data();
    vertices.ray_y = tag.ray_y.data();
    vertices.pixel_x = tag.pixel_x.data();
    vertices.pixel_y = tag.pixel_y.data();
    vertices.depth = tag.depth.data();
    vertices.ka = tag.ka.data();
    vertices.kb = tag.kb.data();
    vertices.rho = tag.rho.data();
    kernel->project(lens, blur, M.data(), tag.lattice_from_ray.data(), vertices);
    const auto max_r2 = static_cast<float>(camera.max_radius() * camera.max_radius());
    for (std::size_t k = 0; k < tag.depth.size(); ++k) {
      const float r2 = tag.ray_x[k] * tag.ray_x[k] + tag.ray_y[k] * tag.ray_y[k];
      if (!(r2 < max_r2)) tag.depth[k] = -1.0F;
    }
  }

  // Whether the tag can be used at the current pose; its size in the image.
  [[nodiscard]] bool measure(Tag& tag, const Vector6d& exposure_motion) const {
    if (!(tag.centre.z() > 0.5)) return false;  // from behind, or the camera lies in the sheet
    const double half = 0.5 * (tag.side - 1);
    const Eigen::Vector3d p = tag.ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
    if (!(p.z() > 0.0)) return false;
    if (std::hypot(p.x(), p.y()) >= camera.max_radius() * p.z()) return false;
    Eigen::Matrix<double, 2, 3> J;
    const Eigen::Vector2d pixel = camera.project_unchecked(p, &J);
    const Eigen::Vector2d along_a = J * tag.ray_from_lattice.col(0);
    const Eigen::Vector2d along_b = J * tag.ray_from_lattice.col(1);
    const double area = std::abs(along_a.x() * along_b.y() - along_a.y() * along_b.x());
    const double across_a = area / along_b.norm();  // the distance between two a-lines
    const double across_b = area / along_a.norm();
    tag.cell_px = std::min(across_a, across_b);
    tag.cell_max_px = std::max(across_a, across_b);
    if (!(tag.cell_px >= options.min_cell_px)) return false;
    const double reach = half * (along_a.norm() + along_b.norm());
    if (!(pixel.x() > -reach && pixel.y() > -reach && pixel.x() < camera.width() + reach &&
          pixel.y() < camera.height() + reach))
      return false;
    // Points of the scene move against the camera.
    const Eigen::Vector3d nu = exposure_motion.head<3>();
    const Eigen::Vector3d omega = exposure_motion.tail<3>();
    tag.motion_px = -(J * (nu + omega.cross(p)));
    const double variance_px = options.blur_px * options.blur_px;
    const Eigen::Matrix2d cov = variance_px * Eigen::Matrix2d::Identity() +
                                tag.motion_px * tag.motion_px.transpose() / 12.0;
    Eigen::Matrix2d basis;
    basis << along_a, along_b;
    const Eigen::Matrix2d G = basis.inverse();
    const Eigen::Matrix2d cov_lattice = G * cov * G.transpose();
    tag.correlation = cov_lattice(0, 1) / std::sqrt(cov_lattice(0, 0) * cov_lattice(1, 1));
    // A line matters up to 2.5 sigma. With one line per axis the next is half a cell or more away,
    // with two a whole one, with three one and a half.
    const double sigma_cells = std::sqrt(std::max(cov_lattice(0, 0), cov_lattice(1, 1)));
    tag.reach = sigma_cells < 0.2 ? 1 : (sigma_cells < 0.4 ? 2 : 3);
    tag.correlated = std::abs(tag.correlation) > 0.3;
    return true;
  }

  void place_all() {
    for (Tag* tag : active) place(*tag);
  }

  // A wide stage feels edges from further off: the model is blurred by up to a quarter of a cell.
  [[nodiscard]] static double wide_variance_px2(const Tag& tag) {
    const double added_px = std::min(2.45, 0.25 * tag.cell_px);
    return added_px * added_px;
  }

  void find_visible(const Vector6d& exposure_motion, bool wide) {
    active.clear();
    for (Tag& tag : tags) {
      place(tag);
      tag.visible = measure(tag, exposure_motion);
      if (!tag.visible) continue;
      if (wide) tag.correlated = false;  // the model is blurred anyway
      project_lattice(tag, wide ? wide_variance_px2(tag) : 0.0);
      active.push_back(&tag);
    }
  }

  // Pixel of a cell's centre by its corners; nothing where a corner has no projection.
  [[nodiscard]] static bool cell_pixel(const Tag& tag, int i, int j, double& x, double& y) {
    const auto v = static_cast<std::size_t>(j * tag.side + i);
    const std::array<std::size_t, 4> corners = {v, v + 1, v + static_cast<std::size_t>(tag.side),
                                                v + static_cast<std::size_t>(tag.side) + 1};
    float sum_x = 0.0F;
    float sum_y = 0.0F;
    for (const std::size_t c : corners) {
      if (!(tag.depth[c] > 0.0F)) return false;
      sum_x += tag.pixel_x[c];
      sum_y += tag.pixel_y[c];
    }
    x = 0.25 * static_cast<double>(sum_x);
    y = 0.25 * static_cast<double>(sum_y);
    return std::abs(x) < 1e5 && std::abs(y) < 1e5;
  }

  [[nodiscard]] bool search(bool independent);
  [[nodiscard]] bool search_within(int search_reach, bool independent);
  void fetch_ahead() const;
  void read_levels();
  void select(Tag& tag, bool wide, int cap);
  void finish_samples(Tag& tag);
  bool step(double cutoff, double& moved_px);
  void stage(bool wide);
  void measure_noise();
  [[nodiscard]] double design_effect(double cutoff) const;
  void verify();
  const AlignmentResult& run(const AlignmentInput& input, bool with_search);
  bool attempt(const Vector6d& exposure_motion, bool with_search, bool independent);
};

// Scores of the data cells' pattern at displacements of the predicted tags, one map per tag; their
// sum tells the common displacement, each map its own tag's near it. The pose is then fitted to the
// tags' displacements, with the prediction's covariance deciding what they leave open.
// `independent`: every tag's own highest peak counts, wherever it is.
bool TagAligner::Impl::search(bool independent) {
  if (independent) return search_within(kSearchReach, true);
  // As far as the prediction may be off (3 sigma); where the peak is not well inside, everywhere.
  double sigma_px = 0.0;
  for (const Tag* tag : active) {
    const double half = 0.5 * (tag->side - 1);
    const Eigen::Vector3d p = tag->ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
    Eigen::Matrix<double, 2, 3> J_p;
    static_cast<void>(camera.project_unchecked(p, &J_p));
    Eigen::Matrix<double, 2, 6> J;
    J << J_p, -J_p * skew(p);
    const Eigen::Matrix2d spread = J * prior_covariance * J.transpose();
    sigma_px = std::max(sigma_px, std::sqrt(std::max(spread(0, 0), spread(1, 1))));
  }
  const double reach = 3.0 * sigma_px + 2.0;
  if (reach <= 15.0 && search_within(15, false)) return true;
  return search_within(kSearchReach, false);
}

bool TagAligner::Impl::search_within(int search_reach, bool independent) {
  const int columns = 2 * (search_reach + 1);
  // With many tags a part of each one's cells is enough.
  const int pairs_per_tag =
      std::clamp(kSearchPoints / (2 * static_cast<int>(active.size())), 4, kMaxSearchCells / 2);
  double smallest_cell = 1e9;
  for (const Tag* tag : active) smallest_cell = std::min(smallest_cell, tag->cell_px);
  // The peak is about a cell high to each side.
  const int row_step = std::clamp(static_cast<int>(smallest_cell / 1.75), 1, 4);
  const int rows = 2 * (search_reach / row_step) + 1;
  const int first_row = -(search_reach / row_step) * row_step;
  score_sum.assign(static_cast<std::size_t>(rows * columns), 0);
  fetch_ahead();
  std::array<const std::uint8_t*, kMaxSearchCells> points{};
  std::array<std::ptrdiff_t, kMaxSearchCells> strides{};
  const int window_rows = rows * row_step;
  int total = 0;
  for (Tag* tag : active) {
    tag->score_points = 0;
    search_scratch.resize(static_cast<std::size_t>(kMaxSearchCells * window_rows * columns));
    int scratch_used = 0;
    int count = 0;
    int positive = 0;
    bool complete = true;
    int inside = 0;
    const int pairs = std::min(pairs_per_tag, tag->search_white);
    for (int k = 0; k < 2 * pairs; ++k) {
      const int of_colour = k < pairs ? k : k - pairs;
      const DataCell& cell = tag->search_cells[static_cast<std::size_t>(
          (k < pairs ? 0 : tag->search_white) + of_colour * tag->search_white / pairs)];
      double px = 0.0;
      double py = 0.0;
      if (!cell_pixel(*tag, cell.i, cell.j, px, py)) {
        complete = false;
        break;
      }
      const int x = floor_of(px + 0.5) - search_reach;
      const int y = floor_of(py + 0.5) + first_row;
      const int cx = x + search_reach;
      const int cy = y - first_row;
      inside += cx >= 0 && cy >= 0 && cx < image.width && cy < image.height ? 1 : 0;
      const auto slot = static_cast<std::size_t>(count);
      if (x >= 0 && y >= 0 && x + columns <= image.width && y + window_rows <= image.height) {
        points[slot] = image.row(y) + x;
        strides[slot] = image.stride;
      } else {
        // The window leaves the image: a copy with the border's pixels repeated.
        std::uint8_t* copy =
            search_scratch.data() + static_cast<std::size_t>(scratch_used++) *
                                        static_cast<std::size_t>(window_rows * columns);
        for (int r = 0; r < window_rows; ++r) {
          const std::uint8_t* source = image.row(std::clamp(y + r, 0, image.height - 1));
          for (int c = 0; c < columns; ++c)
            copy[r * columns + c] = source[std::clamp(x + c, 0, image.width - 1)];
        }
        points[slot] = copy;
        strides[slot] = columns;
      }
      positive += cell.white ? 1 : 0;
      ++count;
    }
    if (!complete || 2 * inside < count || count < 4) continue;
    tag->scores.resize(static_cast<std::size_t>(rows * columns));
    kernel->search(points.data(), strides.data(), positive, count, columns, rows, row_step,
                   tag->scores.data());
    tag->score_points = count;
    total += count;
    for (std::size_t k = 0; k < score_sum.size(); ++k) score_sum[k] += tag->scores[k];
  }
  result.counters.searched_points += total;
  if (total == 0) return false;

  const auto best = std::max_element(score_sum.begin(), score_sum.end()) - score_sum.begin();
  const int best_row = static_cast<int>(best) / columns;
  const int best_column = static_cast<int>(best) % columns;
  // The mean white cell over the mean black one [grey]; below this the peak is one of noise.
  constexpr double kLeastContrast = 12.0;
  const double contrast = 2.0 * score_sum[static_cast<std::size_t>(best)] / total;
  if (!independent && contrast < kLeastContrast) return false;
  if (!independent && search_reach < kSearchReach &&
      (best_row < 2 || best_column < 2 || best_row > rows - 3 || best_column > columns - 3))
    return false;

  struct Displaced {
    Eigen::Vector3d p;  // of the tag's centre, in the table frame
    Eigen::Vector2d z;
    double sigma_px;
  };
  std::vector<Displaced> displaced;
  displaced.reserve(active.size());
  const Eigen::Isometry3d T_table_camera = T_camera_table.inverse();
  for (const Tag* tag : active) {
    if (tag->score_points == 0) continue;
    const int slack = independent ? columns : static_cast<int>(std::ceil(tag->cell_px)) + 2;
    const int slack_rows = slack / row_step;
    const int r0 = std::max(best_row - slack_rows, 0);
    const int r1 = std::min(best_row + slack_rows, rows - 1);
    const int c0 = std::max(best_column - slack, 0);
    const int c1 = std::min(best_column + slack, columns - 1);
    int score = -1;
    int at_row = 0;
    int at_column = 0;
    for (int r = r0; r <= r1; ++r) {
      for (int c = c0; c <= c1; ++c) {
        const int value = tag->scores[static_cast<std::size_t>(r * columns + c)];
        if (value > score) {
          score = value;
          at_row = r;
          at_column = c;
        }
      }
    }
    if (2.0 * score / tag->score_points < std::max(kLeastContrast, 0.4 * contrast)) continue;
    // A peak at the rim of the window is the flank of another.
    if (at_row == 0 || at_column == 0 || at_row == rows - 1 || at_column == columns - 1) continue;
    const auto value_at = [&](int r, int c) {
      return static_cast<double>(tag->scores[static_cast<std::size_t>(r * columns + c)]);
    };
    const auto vertex = [](double before, double middle, double after) {
      const double curvature = before - 2.0 * middle + after;
      return curvature < -1e-9 ? std::clamp(0.5 * (before - after) / curvature, -0.5, 0.5) : 0.0;
    };
    const double dx =
        at_column - search_reach +
        vertex(value_at(at_row, at_column - 1), score, value_at(at_row, at_column + 1));
    const double dy =
        first_row + row_step * (at_row + vertex(value_at(at_row - 1, at_column), score,
                                                value_at(at_row + 1, at_column)));
    const double half = 0.5 * (tag->side - 1);
    const Eigen::Vector3d p_camera = tag->ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
    const Eigen::Vector2d centre = camera.project_unchecked(p_camera);
    displaced.push_back(
        {T_table_camera * p_camera, centre + Eigen::Vector2d(dx, dy), 0.4 + 0.1 * tag->cell_px});
  }
  if (displaced.empty()) return false;

  // Gauss-Newton on the left perturbation of T_camera_table. The rounds of weights start wide and
  // close in, so that a few wrong peaks are left behind.
  for (int round = 0; round < 4; ++round) {
    const double cutoff = round == 0 ? 1e9 : (round == 1 ? 12.0 : 6.0);
    const Vector6d deviation = log_se3(T_camera_table * T_predicted.inverse());
    Matrix6d H = prior_information;
    Vector6d g = -prior_information * deviation;
    for (const Displaced& d : displaced) {
      const Eigen::Vector3d p = T_camera_table * d.p;
      if (!(p.z() > 0.0)) continue;
      Eigen::Matrix<double, 2, 3> J_p;
      const Eigen::Vector2d r = d.z - camera.project_unchecked(p, &J_p);
      const double t = r.norm() / (d.sigma_px * cutoff);
      if (t >= 1.0) continue;
      const double w = (1.0 - t * t) * (1.0 - t * t) / (d.sigma_px * d.sigma_px);
      Eigen::Matrix<double, 2, 6> J;
      J.leftCols<3>() = J_p;
      J.rightCols<3>() = -J_p * skew(p);
      H += w * J.transpose() * J;
      g += w * J.transpose() * r;
    }
    const Vector6d xi = H.ldlt().solve(g);
    if (!xi.allFinite()) return false;
    T_camera_table = exp_se3(xi) * T_camera_table;
  }
  return true;
}

// Asks for the image around the tags: it is read in no order that a processor foresees, and a frame
// fresh from a camera or a decoder lies in no near cache.
void TagAligner::Impl::fetch_ahead() const {
  float x0 = 1e9F;
  float y0 = 1e9F;
  float x1 = -1e9F;
  float y1 = -1e9F;
  for (const Tag* tag : active) {
    const auto last = static_cast<std::size_t>(tag->side - 1);
    const auto width = static_cast<std::size_t>(tag->side);
    for (const std::size_t v : {std::size_t{0}, last, last * width, last * width + last}) {
      if (!(tag->depth[v] > 0.0F)) continue;
      x0 = std::min(x0, tag->pixel_x[v]);
      y0 = std::min(y0, tag->pixel_y[v]);
      x1 = std::max(x1, tag->pixel_x[v]);
      y1 = std::max(y1, tag->pixel_y[v]);
    }
  }
  const auto clip = [](float value, int limit) {
    return static_cast<int>(std::clamp(value, 0.0F, static_cast<float>(limit)));
  };
  const int left = clip(x0 - kSearchReach, image.width - 1);
  const int right = clip(x1 + kSearchReach, image.width - 1);
  const int top = clip(y0 - kSearchReach, image.height - 1);
  const int bottom = clip(y1 + kSearchReach, image.height - 1);
  for (int y = top; y <= bottom; ++y) {
    const std::uint8_t* row = image.row(y);
    for (int x = left; x <= right; x += 64) __builtin_prefetch(row + x);
  }
}

// Gain and offset of each tag from its data cells, so that nothing is carried over from another
// exposure.
void TagAligner::Impl::read_levels() {
  for (Tag* tag : active) {
    double white = 0.0;
    double black = 0.0;
    int whites = 0;
    int blacks = 0;
    for (const DataCell& cell : tag->pattern.data_cells()) {
      double x = 0.0;
      double y = 0.0;
      if (!cell_pixel(*tag, cell.i, cell.j, x, y)) continue;
      const int px = floor_of(x + 0.5);
      const int py = floor_of(y + 0.5);
      if (px < 0 || py < 0 || px >= image.width || py >= image.height) continue;
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

// One Gauss-Newton step over all active tags, gains and offsets eliminated. `cutoff`: of Tukey's
// weights, as a share of the gain; 0: none. moved_px: how far the tags' centres and corners went at
// most.
bool TagAligner::Impl::step(double cutoff, double& moved_px) {
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  if (eliminated.size() < active.size()) eliminated.resize(active.size());
  double cost = 0.0;
  double weight = 0.0;
  for (std::size_t k = 0; k < active.size(); ++k) {
    Tag& tag = *active[k];
    eliminated[k].valid = false;
    if (tag.used < 16 || !(tag.gain > 1.0)) continue;
    kernel::AccumulateInput in;
    std::copy(tag.lattice_from_ray.begin(), tag.lattice_from_ray.end(), in.lattice_from_ray);
    for (int c = 0; c < 3; ++c) in.centre[c] = static_cast<float>(tag.centre[c]);
    in.gain = static_cast<float>(tag.gain);
    in.offset = static_cast<float>(tag.offset);
    // Never cut into the noise itself, and no further out than it asks for.
    double limit = cutoff * tag.gain;
    if (noise_share > 0.0) limit = tag.gain * std::clamp(4.685 * noise_share, 0.03, cutoff);
    in.inverse_cutoff = cutoff > 0.0 ? static_cast<float>(1.0 / limit) : 0.0F;
    in.reach = tag.reach;
    in.correlated = tag.correlated;
    kernel->accumulate(in, tag.samples, tag.sums);
    const kernel::Sums& sums = tag.sums;
    Eigen::Matrix<double, 8, 8> full;
    int index = 0;
    for (int p = 0; p < 8; ++p) {
      for (int q = p; q < 8; ++q, ++index) full(p, q) = full(q, p) = sums.H[index];
    }
    const Eigen::Map<const Eigen::Matrix<double, 8, 1>> gradient(sums.g);
    if (!full.allFinite() || !(sums.weight > 8.0)) continue;
    Eliminated& e = eliminated[k];
    Eigen::Matrix2d levels = full.bottomRightCorner<2, 2>();
    const double det = levels.determinant();
    if (!(det > 1e-6 * levels(0, 0) * levels(1, 1))) continue;
    e.inverse = levels.inverse();
    e.cross = full.topRightCorner<6, 2>();
    e.gradient = gradient.tail<2>();
    const Matrix6d H_tag = full.topLeftCorner<6, 6>() - e.cross * e.inverse * e.cross.transpose();
    const Vector6d g_tag = gradient.head<6>() - e.cross * e.inverse * e.gradient;
    e.adjoint.setZero();
    e.adjoint.topLeftCorner<3, 3>() = tag.R_lattice_camera / tag.cell_m;
    e.adjoint.topRightCorner<3, 3>() = skew(tag.centre) * tag.R_lattice_camera;
    e.adjoint.bottomRightCorner<3, 3>() = tag.R_lattice_camera;
    H += e.adjoint.transpose() * H_tag * e.adjoint;
    g += e.adjoint.transpose() * g_tag;
    e.valid = true;
    cost += sums.cost;
    weight += sums.weight;
  }
  ++result.counters.evaluations;
  if (!(weight > 12.0)) return false;
  variance = std::max(cost / weight, 0.25);  // a grey level's own rounding at least
  information = H / variance;
  const Vector6d deviation = log_se3(T_camera_table * T_predicted.inverse());
  const Matrix6d H_prior = H + variance * prior_information;
  const Vector6d xi = H_prior.ldlt().solve(g - variance * (prior_information * deviation));
  if (!xi.allFinite()) return false;
  for (std::size_t k = 0; k < active.size(); ++k) {
    const Eliminated& e = eliminated[k];
    if (!e.valid) continue;
    Tag& tag = *active[k];
    const Eigen::Vector2d levels =
        e.inverse * (e.gradient - e.cross.transpose() * (e.adjoint * xi));
    // A gain of nothing or less is no tag; it is kept just above, to come back.
    tag.gain = std::max(tag.gain + levels[0], 1.5);
    tag.offset += levels[1];
  }
  const Eigen::Isometry3d motion = exp_se3(xi);
  T_camera_table = motion * T_camera_table;
  moved_px = 0.0;
  for (Tag* tag : active) {
    const double width = tag->side - 1;
    for (const Eigen::Vector2d& corner :
         {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(width, 0.0), Eigen::Vector2d(width, width),
          Eigen::Vector2d(0.0, width)}) {
      const Eigen::Vector3d p =
          tag->ray_from_lattice * Eigen::Vector3d(corner.x(), corner.y(), 1.0);
      const Eigen::Vector3d q = motion * p;
      if (!(p.z() > 0.0 && q.z() > 0.0)) continue;
      const Eigen::Vector2d shift((q.x() / q.z() - p.x() / p.z()) * camera.parameters().fx,
                                  (q.y() / q.z() - p.y() / p.z()) * camera.parameters().fy);
      moved_px = std::max(moved_px, shift.norm());
    }
    place(*tag);
  }
  return true;
}

bool TagAligner::Impl::attempt(const Vector6d& exposure_motion, bool with_search,
                               bool independent) {
  T_camera_table = T_predicted;
  find_visible(exposure_motion, true);
  result.counters.tags_visible = static_cast<int>(active.size());
  if (active.empty()) {
    result.reason = "no tag in view";
    return false;
  }
  if (with_search && search(independent)) find_visible(exposure_motion, true);
  if (active.empty()) {
    result.reason = "no tag in view";
    return false;
  }
  read_levels();
  variance = 0.0;
  noise_share = 0.0;
  double moved = 0.0;
  const int wide_cap = filled_blocks(active.size() > 8 ? 1 : 2);
  for (Tag* tag : active) select(*tag, true, wide_cap);
  if (!step(0.0, moved) || !step(0.8, moved)) {
    result.reason = "too few pixels on tags";
    return false;
  }
  const int cap = options.effort == AlignmentEffort::accurate
                      ? 1'000'000
                      : filled_blocks(std::clamp(
                            options.samples / (kernel::kBlock * static_cast<int>(active.size())), 2,
                            std::max(2, options.samples_per_tag / kernel::kBlock)));
  noise_share = 0.0;
  const double settled = options.effort == AlignmentEffort::accurate ? 0.85 : 0.7;
  for (int round = 0; round < kFineRounds; ++round) {
    ++result.counters.fine_rounds;
    find_visible(exposure_motion, false);
    result.counters.samples = 0;
    for (Tag* tag : active) {
      select(*tag, false, cap);
      result.counters.samples += tag->used;
    }
    double round_moved = 0.0;
    for (int i = 0; i < kFineSteps; ++i) {
      if (!step(kFineCutoff, moved)) {
        result.reason = "too few pixels on tags";
        return false;
      }
      const double before = noise_share;
      measure_noise();
      round_moved += moved;
      // While outliers are still being left behind the pose may yet move.
      if (i > 0 && moved < kConverged_px && noise_share > settled * before) break;
    }
    if (round_moved < kCornerMoved_px) break;
  }
  result.design_effect = design_effect(kFineCutoff);
  verify();
  return result.verified;
}

// The residuals' size as a share of the gain, by their median: what covers a part of the tags does
// not count. The median is that of a histogram whose classes are the leading bits of the floats
// (16 to an octave), interpolated within its class.
void TagAligner::Impl::measure_noise() {
  constexpr std::uint32_t kShift = 19;                  // leaves 4 bits of the mantissa
  constexpr std::uint32_t kFirst = (127U - 16U) << 4U;  // 2^-16 of the gain and less
  constexpr std::size_t kClasses = 20 * 16;             // up to 2^4
  std::array<std::uint16_t, kClasses> histogram{};
  int total = 0;
  for (const Tag* tag : active) total += tag->used;
  const int stride = std::max(1, total / 384);
  int count = 0;
  int next = 0;
  for (const Tag* tag : active) {
    if (!(tag->gain > 1.5)) continue;
    const auto inverse_gain = static_cast<float>(1.0 / tag->gain);
    for (; next < tag->used; next += stride) {
      const auto bits =
          std::bit_cast<std::uint32_t>(std::abs(tag->samples.residual[next]) * inverse_gain);
      const std::uint32_t position = std::max(bits >> kShift, kFirst) - kFirst;
      ++histogram[std::min<std::size_t>(position, kClasses - 1)];
      ++count;
    }
    next -= tag->used;
  }
  if (count < 16) return;
  const double middle = 0.5 * count;
  double below = 0.0;
  std::size_t at = 0;
  while (below + histogram[at] < middle) below += histogram[at++];
  const auto edge = [](std::size_t position) {
    return static_cast<double>(
        std::bit_cast<float>((static_cast<std::uint32_t>(position) + kFirst) << kShift));
  };
  const double within = (middle - below) / histogram[at];
  noise_share = 1.4826 * (edge(at) + within * (edge(at + 1) - edge(at)));
}

// How many times larger the variance of the mean displacement of an edge is than independent
// residuals would make it (the "design effect" of samples that come in clusters): the residuals of
// each run of samples along one edge, projected on what a displacement of that edge would do to
// them, squared, over what the residuals' own variance lets expect. What compression, denoising and
// wrong models of blur do to whole edges shows here. A tone curve or a bright lamp widens all white
// areas: a displacement of every edge towards black, by more where the edge is blurred by motion,
// with which opposite edges of a cell leave the pose where it is; it is taken out first, for each
// of the tag's two directions.
double TagAligner::Impl::design_effect(double cutoff) const {
  struct Direction {  // edges along b, and along a
    double s = 0.0, q = 0.0, ss = 0.0, sq = 0.0, qq = 0.0;
  };
  std::array<Direction, 2> directions;
  double expected = 0.0;
  int runs = 0;
  int parameters = 8;  // the pose and the widenings
  const double limit = noise_share > 0.0 ? std::clamp(4.685 * noise_share, 0.03, cutoff) : cutoff;
  const auto inverse_limit = static_cast<float>(1.0 / limit);
  for (const Tag* tag : active) {
    if (tag->used < 16 || !(tag->gain > 1.5)) continue;
    parameters += 2;
    const kernel::Samples& s = tag->samples;
    const auto inverse_gain = static_cast<float>(1.0 / tag->gain);
    const auto offset = static_cast<float>(tag->offset);
    double tag_expected = 0.0;
    int begin = 0;
    for (const auto& [end, vertical] : tag->run_samples) {
      float along = 0.0F;
      float width = 0.0F;
      float squares = 0.0F;
      for (int i = begin; i < end; ++i) {
        const float r = s.residual[i] * inverse_gain;
        const float m = (s.value[i] - offset) * inverse_gain - r;
        const float t = r * inverse_limit;
        const float inside = std::max(1.0F - t * t, 0.0F);
        const float slope = std::max(m * (1.0F - m), 0.0F);  // of a blurred edge, nearly
        const float lever = slope * inside * inside;
        along += lever * r;
        width += lever * slope;
        squares += lever * lever;
      }
      begin = end;
      if (!(squares > 0.0F)) continue;
      const auto S = static_cast<double>(along);
      const auto Q = static_cast<double>(width);
      Direction& direction = directions[vertical ? 0 : 1];
      direction.s += S;
      direction.q += Q;
      direction.ss += S * S;
      direction.sq += S * Q;
      direction.qq += Q * Q;
      tag_expected += static_cast<double>(squares);
      ++runs;
    }
    expected += tag_expected * variance / (tag->gain * tag->gain);
  }
  const int free = runs - parameters;
  if (free < 4 || !(expected > 0.0)) return 1.0;
  double found = 0.0;
  for (const Direction& d : directions) {
    if (!(d.q > 0.0)) continue;
    const double widening = d.s / d.q;
    found += d.ss - 2.0 * widening * d.sq + widening * widening * d.qq;
  }
  return std::max(found, 0.0) / expected * runs / free;
}

// Reads the data cells at the solved pose against the model's own blurred values.
void TagAligner::Impl::verify() {
  result.tags.clear();
  result.tags_verified = 0;
  int visible = 0;
  for (Tag* tag : active) {
    project_lattice(*tag, 0.0);
    TagAlignment check;
    check.index = static_cast<int>(tag - tags.data());
    check.gain = tag->gain;
    check.offset = tag->offset;
    check.weight_share =
        tag->sums.base_weight > 0.0 ? tag->sums.weight / tag->sums.base_weight : 0.0;
    // The model at the cells' centres; with coarse cells that is the cell's colour.
    const std::vector<DataCell>& cells = tag->pattern.data_cells();
    tag->storage.resize(static_cast<int>(cells.size()));
    tag->samples = tag->storage.view();
    kernel::Samples& s = tag->samples;
    tag->used = 0;
    for (const DataCell& cell : cells) {
      double x = 0.0;
      double y = 0.0;
      if (!cell_pixel(*tag, cell.i, cell.j, x, y)) continue;
      const int px = floor_of(x + 0.5);
      const int py = floor_of(y + 0.5);
      if (px < 0 || py < 0 || px >= image.width || py >= image.height) continue;
      const auto v = static_cast<std::size_t>(cell.j * tag->side + cell.i);
      s.pixel_x[tag->used] = static_cast<float>(px);
      s.pixel_y[tag->used] = static_cast<float>(py);
      s.ray_x[tag->used] = tag->ray_x[v];
      s.ray_y[tag->used] = tag->ray_y[v];
      ++tag->used;
    }
    finish_samples(*tag);
    kernel::AccumulateInput in;
    std::copy(tag->lattice_from_ray.begin(), tag->lattice_from_ray.end(), in.lattice_from_ray);
    in.reach = tag->reach;
    in.correlated = tag->correlated;
    kernel->evaluate(in, s);
    int decidable = 0;
    for (int i = 0; i < tag->used; ++i) {
      const double expected = static_cast<double>(s.model[i]) - 0.5;
      if (std::abs(expected) < 0.15) continue;  // too blurred to be one or the other
      const double read = static_cast<double>(s.value[i]) - (tag->offset + 0.5 * tag->gain);
      // What reads as neither black nor white is covered by something.
      ++decidable;
      if (std::abs(read) < 0.25 * tag->gain && std::abs(expected) > 0.45) continue;
      ++check.cells_read;
      check.cells_wrong += expected * read < 0.0 ? 1 : 0;
    }
    const int least = std::max(8, static_cast<int>(cells.size()) / 4);
    const int right = check.cells_read - check.cells_wrong;
    check.verified = check.cells_read >= least && 4 * check.cells_wrong <= check.cells_read &&
                     20 * right >= 9 * decidable && check.gain > 12.0 && check.weight_share > 0.3;
    visible += decidable >= least ? 1 : 0;
    result.tags_verified += check.verified ? 1 : 0;
    result.tags.push_back(check);
  }
  result.verified = result.tags_verified > 0 && 10 * result.tags_verified >= 4 * visible;
  if (!result.verified) result.reason = "the cells do not read as these tags";
}

const AlignmentResult& TagAligner::Impl::run(const AlignmentInput& input, bool with_search) {
  PENUMBRA_ASSERT(input.luma.width == camera.width() && input.luma.height == camera.height() &&
                  !input.luma.empty());
  PENUMBRA_ASSERT(input.predicted.is_finite() && input.covariance.allFinite());
  result.verified = false;
  result.tags.clear();
  result.tags_verified = 0;
  result.counters = {};
  result.reason = {};
  result.residual_rms = 0.0;
  result.design_effect = 1.0;
  image = input.luma;
  T_predicted = Eigen::Isometry3d::Identity();
  const CameraPose& pose = input.predicted;
  T_predicted.linear() = pose.rotation().conjugate().toRotationMatrix();
  T_predicted.translation() = -(T_predicted.linear() * pose.translation());
  // A right perturbation of T_table_camera by xi is a left one of T_camera_table by -xi: the same
  // covariance.
  prior_covariance = input.covariance;
  prior_information = prior_covariance.ldlt().solve(Matrix6d::Identity());
  PENUMBRA_ASSERT(prior_information.allFinite());

  bool good = attempt(input.exposure_motion, with_search, false);
  if (!good && with_search && !active.empty()) {
    result.counters.second_try = true;
    good = attempt(input.exposure_motion, true, true);
  }
  const Eigen::Isometry3d T_table_camera = T_camera_table.inverse();
  result.T_table_camera =
      CameraPose(Eigen::Matrix3d(T_table_camera.linear()), T_table_camera.translation());
  const Matrix6d total = information + prior_information;
  result.covariance = total.ldlt().solve(Matrix6d::Identity());
  double gain = 0.0;
  for (const Tag* tag : active) gain += tag->gain;
  if (!active.empty() && gain > 0.0)
    result.residual_rms = std::sqrt(variance) / (gain / static_cast<double>(active.size()));
  return result;
}

TagAligner::TagAligner(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TagAligner::TagAligner(TagAligner&&) noexcept = default;
TagAligner& TagAligner::operator=(TagAligner&&) noexcept = default;
TagAligner::~TagAligner() = default;

Result<TagAligner> TagAligner::create(const CameraModel& camera, std::span<const MappedTag> tags,
                                      const AlignmentOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->camera = camera;
  impl->options = options;
  impl->kernel = &kernel::best_variant();
  if (options.kernel != nullptr) {
    for (const kernel::Variant* const* v = kernel::available_variants(); *v != nullptr; ++v) {
      if (std::strcmp((*v)->name, options.kernel) == 0) impl->kernel = *v;
    }
  }
  const CameraParameters& p = camera.parameters();
  impl->lens.fx = static_cast<float>(p.fx);
  impl->lens.fy = static_cast<float>(p.fy);
  impl->lens.cx = static_cast<float>(p.cx);
  impl->lens.cy = static_cast<float>(p.cy);
  for (std::size_t k = 0; k < 8; ++k) impl->lens.k[k] = static_cast<float>(p.distortion[k]);
  impl->lens.kind = !camera.has_distortion()               ? kernel::Lens::Kind::none
                    : p.model == DistortionModel::fisheye  ? kernel::Lens::Kind::fisheye
                    : p.model == DistortionModel::rational ? kernel::Lens::Kind::rational
                                                           : kernel::Lens::Kind::polynomial;
  impl->set_tone(p.tone_curve ? *p.tone_curve : options.tone_exponent);
  for (const MappedTag& mapped : tags) {
    Result<TagPattern> pattern = TagPattern::make(mapped.family, mapped.id);
    if (!pattern) return tl::unexpected<Error>(pattern.error());
    Tag tag;
    tag.pattern = std::move(*pattern);
    tag.T_table_tag = mapped.T_table_tag;
    tag.cell_m = mapped.size_m / tag.pattern.width_at_border();
    tag.side = tag.pattern.total_width() + 1;
    for (int j = 0; j < tag.side; ++j) {
      for (int i = 0; i < tag.side; ++i) {
        tag.lattice_a.push_back(static_cast<float>(i));
        tag.lattice_b.push_back(static_cast<float>(j));
        const auto colour = [&](int di, int dj) {
          return tag.pattern.white(i + di, j + dj) ? 1.0F : 0.0F;
        };
        const float c0 = colour(-1, -1);
        const float c1 = colour(0, -1) - c0;
        const float c2 = colour(-1, 0) - c0;
        tag.coefficients1.push_back({c0, c1, c2, colour(0, 0) - c0 - c1 - c2});
        for (const int lines : {2, 3}) {
          const int first = lines == 3 ? -1 : 0;  // of the lines; cells count from first - 1
          std::array<float, 16> c{};
          for (int row = 0; row < lines; ++row) {
            const int dj = first + row;
            for (int column = 0; column < lines; ++column) {
              const int di = first + column;
              c[static_cast<std::size_t>(4 * row + column)] =
                  colour(di, dj) - colour(di - 1, dj) - colour(di, dj - 1) + colour(di - 1, dj - 1);
            }
            c[static_cast<std::size_t>(4 * row + 3)] =
                colour(first - 1, dj) - colour(first - 1, dj - 1);
          }
          for (int column = 0; column < lines; ++column)
            c[static_cast<std::size_t>(12 + column)] =
                colour(first + column, first - 1) - colour(first + column - 1, first - 1);
          c[15] = colour(first - 1, first - 1);
          (lines == 2 ? tag.coefficients2 : tag.coefficients3).push_back(c);
        }
      }
    }
    // Filled up for the kernel with repetitions of the last vertex.
    while (tag.lattice_a.size() % 16 != 0) {
      tag.lattice_a.push_back(tag.lattice_a.back());
      tag.lattice_b.push_back(tag.lattice_b.back());
    }
    const std::size_t vertices = tag.lattice_a.size();
    for (auto* array : {&tag.ray_x, &tag.ray_y, &tag.pixel_x, &tag.pixel_y, &tag.depth, &tag.ka,
                        &tag.kb, &tag.rho})
      array->resize(vertices);
    // As many white as black cells, spread over the tag.
    std::vector<DataCell> white;
    std::vector<DataCell> black;
    for (const DataCell& cell : tag.pattern.data_cells())
      (cell.white ? white : black).push_back(cell);
    const std::size_t pairs =
        std::min({white.size(), black.size(), static_cast<std::size_t>(kMaxSearchCells / 2)});
    tag.search_white = static_cast<int>(pairs);
    for (std::vector<DataCell>* cells : {&white, &black}) {
      for (std::size_t k = 0; k < pairs; ++k)
        tag.search_cells.push_back((*cells)[k * cells->size() / pairs]);
    }
    impl->tags.push_back(std::move(tag));
  }
  return TagAligner(std::move(impl));
}

const AlignmentOptions& TagAligner::options() const {
  return impl_->options;
}
void TagAligner::set_effort(AlignmentEffort effort) {
  impl_->options.effort = effort;
}
void TagAligner::set_tone_exponent(double exponent) {
  impl_->set_tone(exponent);
}
void TagAligner::set_blur(double blur_px) {
  impl_->options.blur_px = blur_px;
}
const AlignmentResult& TagAligner::align(const AlignmentInput& input) {
  return impl_->run(input, true);
}
const AlignmentResult& TagAligner::refine(const AlignmentInput& input) {
  return impl_->run(input, false);
}

}  // namespace penumbra
