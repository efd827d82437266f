#include "tracking/alignment/pattern_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <span>
#include <tuple>

#include "tracking/math/se3.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

constexpr int kSearchPoints = 256;  // target number of cells of all tags together
constexpr int kNarrowReach = 15;    // maximum displacement in the narrow window [px]
constexpr int kCoarsest = 16;       // maximum reduction factor of the pyramid
// Minimum contrast of a peak above noise: mean white cell minus mean black cell [grey].
constexpr double kMinContrast = 12.0;
// A peak with this fraction of the previous contrast ends a search. A wrong peak has up to half.
constexpr double kPreviousContrastFraction = 0.75;
// Maximum errors from which the fine stage converges without the wide stage.
constexpr double kNearError_px = 1.2;
constexpr double kNearError_cells = 0.2;
// Error of a peak's centre caused by the spacing of rows, as a fraction of that spacing.
constexpr double kRowGrid = 0.1;
constexpr std::size_t kMinTagsForScatter = 5;  // minimum number of tags to measure their scatter

// Centre of a peak in a score map [rows and columns].
struct PeakCentre {
  double row = 0.0;
  double column = 0.0;
  bool open = false;  // the peak may extend beyond the map
};

// Returns the centroid of the scores, clamped to [foot, shoulder] because the peak has a flat top.
template <class Score>
PeakCentre peak_centre(const SearchWindow& window, std::span<const Score> scores, int row,
                       int column, double cell) {
  // Foot and shoulder, in fifths of the peak. The scores of a displaced pattern are below the foot.
  constexpr int kParts = 5;
  constexpr int kFoot = 3;
  constexpr int kShoulder = 4;
  const int last_row = window.rows - 1;
  const int last_column = 2 * window.reach;
  const auto peak =
      static_cast<int>(scores[static_cast<std::size_t>(row * window.columns + column)]);
  if (peak <= 0) return {static_cast<double>(row), static_cast<double>(column), true};
  // The flat top extends about one cell from the maximum.
  const int half = static_cast<int>(std::ceil(cell)) + 1;
  const int half_rows = (half + window.row_step - 1) / window.row_step;
  const int r0 = std::max(row - half_rows, 0);
  const int r1 = std::min(row + half_rows, last_row);
  const int c0 = std::max(column - half, 0);
  const int c1 = std::min(column + half, last_column);
  const int foot = kFoot * peak / kParts;
  const int shoulder = kShoulder * peak / kParts;
  double sum = 0.0;
  double sum_rows = 0.0;
  double sum_columns = 0.0;
  bool open = false;
  for (int r = r0; r <= r1; ++r) {
    const Score* const row_scores = scores.data() + static_cast<std::ptrdiff_t>(r) * window.columns;
    int row_sum = 0;
    int row_moment = 0;  // relative to c0
    int highest = 0;
    for (int c = c0; c <= c1; ++c) {
      const int value = row_scores[c];
      const int up = std::clamp(value, foot, shoulder) - foot;
      row_sum += up;
      row_moment += up * (c - c0);
      highest = std::max(highest, value);
    }
    open = open || ((r == 0 || r == last_row) && highest >= shoulder) ||
           (c0 == 0 && row_scores[0] >= shoulder) ||
           (c1 == last_column && row_scores[last_column] >= shoulder);
    sum += row_sum;
    sum_rows += static_cast<double>(row_sum) * r;
    sum_columns += static_cast<double>(row_moment) + static_cast<double>(row_sum) * c0;
  }
  if (!(sum > 0.0)) return {static_cast<double>(row), static_cast<double>(column), open};
  return {sum_rows / sum, sum_columns / sum, open};
}

Eigen::Vector2d displacement(const SearchWindow& window, const PeakCentre& top) {
  return {top.column - window.reach, window.first_row + window.row_step * top.row};
}

struct TagPeak {
  int row = 0, column = 0;
};

// Returns the maximum of a tag's score map within `slack` of `about`, or nullopt if its contrast
// (white minus black cells [grey]) is too small or it is on the flank of a higher peak outside.
std::optional<TagPeak> find_tag_peak(const AlignedTag& tag, const SearchWindow& window,
                                     TagPeak about, int slack, double min_contrast) {
  const int columns = window.columns;
  const int last_row = window.rows - 1;
  const int last_column = 2 * window.reach;
  const int slack_rows = slack / window.row_step;
  const int r0 = std::max(about.row - slack_rows, 0);
  const int r1 = std::min(about.row + slack_rows, last_row);
  const int c0 = std::max(about.column - slack, 0);
  const int c1 = std::min(about.column + slack, last_column);
  const auto value = [&](int r, int c) {
    return tag.scores[static_cast<std::size_t>(r * columns + c)];
  };
  int score = -1;
  int at_row = 0;
  int at_column = 0;
  for (int r = r0; r <= r1; ++r) {
    for (int c = c0; c <= c1; ++c) {
      if (value(r, c) <= score) continue;
      score = value(r, c);
      at_row = r;
      at_column = c;
    }
  }
  if (2.0 * score / tag.score_points < min_contrast) return std::nullopt;
  if ((at_row == r0 && r0 > 0 && value(r0 - 1, at_column) > score) ||
      (at_row == r1 && r1 < last_row && value(r1 + 1, at_column) > score) ||
      (at_column == c0 && c0 > 0 && value(at_row, c0 - 1) > score) ||
      (at_column == c1 && c1 < last_column && value(at_row, c1 + 1) > score))
    return std::nullopt;
  return TagPeak{at_row, at_column};
}

// d pixel / d xi of a point p of the camera frame, for a left perturbation xi of T_camera_map.
using PointJacobian = Eigen::Matrix<double, 2, 6>;
PointJacobian jacobian_of(const Eigen::Matrix<double, 2, 3>& J_p, const Eigen::Vector3d& p) {
  PointJacobian J;
  J << J_p, -J_p * skew(p);
  return J;
}

// Adds w J^T J to the lower triangle.
void add_point(const PointJacobian& J, double w, Matrix6d& H) {
#pragma GCC unroll 6
  for (int row = 0; row < 6; ++row) {
    const double w0 = w * J(0, row);
    const double w1 = w * J(1, row);
#pragma GCC unroll 6
    for (int column = 0; column <= row; ++column)
      H(row, column) += w0 * J(0, column) + w1 * J(1, column);
  }
}

PointJacobian jacobian_at(const CameraModel& camera, const Eigen::Vector3d& p) {
  Eigen::Matrix<double, 2, 3> J_p;
  std::ignore = camera.project_unchecked(p, &J_p);
  return jacobian_of(J_p, p);
}

// Fits T_camera_map by Gauss-Newton; a shrinking cutoff of the weights rejects wrong peaks.
bool fit_displaced(const std::vector<DisplacedTag>& displaced, AlignmentProblem& problem) {
  Eigen::Isometry3d T = problem.T_camera_map;
  for (int round = 0; round < 4; ++round) {
    const double cutoff = round == 0 ? 1e9 : (round == 1 ? 12.0 : 6.0);
    const Vector6d deviation = log_se3(T * problem.T_predicted.inverse());
    Matrix6d H = problem.prior_information;
    Vector6d g = -problem.prior_information * deviation;
    for (const DisplacedTag& d : displaced) {
      const Eigen::Vector3d p = T * d.p;
      if (!(p.z() > 0.0)) continue;
      Eigen::Matrix<double, 2, 3> J_p;
      const Eigen::Vector2d r = d.z - problem.camera.project_unchecked(p, &J_p);
      const double t = r.norm() / (d.sigma_px * cutoff);
      if (t >= 1.0) continue;
      const double w = (1.0 - t * t) * (1.0 - t * t) / (d.sigma_px * d.sigma_px);
      const PointJacobian J = jacobian_of(J_p, p);
      add_point(J, w, H);
      g += J.transpose() * (w * r);
    }
    const Vector6d xi = solve_spd(H, g);
    if (!xi.allFinite()) return false;
    T = exp_se3(xi) * T;
  }
  problem.T_camera_map = T;
  return true;
}

// Returns the maximum error of the fit at a tag's corner [px], 1 sigma, from the scatter of the
// tags and the covariance of the prediction; infinite if unknown.
double fit_error_px(const std::vector<DisplacedTag>& displaced, const AlignmentProblem& problem) {
  // Prior of the scatter, with the weight of four values.
  constexpr double kScatter_cells = 0.05;
  constexpr double kScatterNumbers = 4.0;
  if (displaced.size() < kMinTagsForScatter) return std::numeric_limits<double>::infinity();
  double sum2 = 0.0;
  double cells = 0.0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  Matrix6d H = Matrix6d::Zero();
  for (const DisplacedTag& d : displaced) {
    if (d.open) return std::numeric_limits<double>::infinity();
    const Eigen::Vector3d p = problem.T_camera_map * d.p;
    Eigen::Matrix<double, 2, 3> J_p;
    sum2 += (d.z - problem.camera.project_unchecked(p, &J_p)).squaredNorm();
    add_point(jacobian_of(J_p, p), 1.0, H);
    cells += d.cell_px;
    middle += d.z;
  }
  const auto n = static_cast<double>(displaced.size());
  middle /= n;
  const double scatter2 = (sum2 + kScatterNumbers * std::pow(kScatter_cells * cells / n, 2)) /
                          (2.0 * n - 6.0 + kScatterNumbers);
  const Matrix6d covariance = inverse_of_spd(H / scatter2 + problem.prior_information);
  double largest2 = 0.0;
  for (const AlignedTag* tag : problem.active) {
    // Finds the tag's corner that is farthest from the centre of all tags.
    const std::size_t first = tag->search_cells.size();
    double farthest2 = -1.0;
    std::size_t corner = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      const double distance2 =
          (Eigen::Vector2d(tag->search_x[first + k], tag->search_y[first + k]) - middle)
              .squaredNorm();
      if (!(distance2 > farthest2)) continue;
      farthest2 = distance2;
      corner = k;
    }
    const double last = tag->side - 1;
    const Eigen::Vector3d p = tag->point(corner % 2 == 0 ? 0.0 : last, corner < 2 ? 0.0 : last);
    const PointJacobian J = jacobian_at(problem.camera, p);
    largest2 = std::max(largest2, (J * covariance * J.transpose()).trace());
  }
  return std::sqrt(largest2);
}

}  // namespace

SearchWindow PatternSearch::window_of(int reach) const {
  // A peak extends about a cell to each side.
  const int row_step =
      std::clamp(static_cast<int>(problem_.smallest_cell_px() / scale_ / 1.75), 1, 4);
  return {reach, row_step};
}

void PatternSearch::begin_full_size() {
  view_ = problem_.image;
  scale_ = 1;
  error_px_ = std::numeric_limits<double>::infinity();
}

bool PatternSearch::search_independently() {
  begin_full_size();
  return search_within(window_of(kReach), true, kMinContrast);
}

bool PatternSearch::search(double previous_contrast) {
  begin_full_size();
  double sigma_px = 0.0;
  double smallest_cell_max_px = 1e9;
  for (const AlignedTag* tag : problem_.active) {
    smallest_cell_max_px = std::min(smallest_cell_max_px, tag->cell_max_px);
    const PointJacobian J = jacobian_at(problem_.camera, tag->centre_point());
    const Eigen::Matrix2d spread = J * problem_.prior_covariance * J.transpose();
    sigma_px = std::max(sigma_px, std::sqrt(std::max(spread(0, 0), spread(1, 1))));
  }
  const SearchWindow narrow = window_of(kNarrowReach);
  if (narrow.holds(0.5 * smallest_cell_max_px)) {  // the top of a peak is as wide as a cell
    // A nearby peak with the previous frame's contrast excludes peaks elsewhere.
    const bool sufficient = narrow.holds(3.0 * sigma_px);
    const bool contrast_known = previous_contrast > 0.0;
    const double required_contrast =
        sufficient ? kMinContrast
                   : std::max(kPreviousContrastFraction * previous_contrast, kMinContrast);
    if ((sufficient || contrast_known) && search_within(narrow, false, required_contrast))
      return true;
  }
  return search_within(window_of(kReach), false, kMinContrast);
}

bool PatternSearch::found_near() const {
  return error_px_ <= std::min(kNearError_px, kNearError_cells * problem_.smallest_cell_px());
}

bool PatternSearch::search_pyramid(bool further) {
  std::vector<double> cells;
  cells.reserve(problem_.active.size());
  for (const AlignedTag* tag : problem_.active) cells.push_back(tag->cell_px);
  const auto middle = cells.begin() + static_cast<std::ptrdiff_t>(cells.size() / 2);
  std::nth_element(cells.begin(), middle, cells.end());
  int scale = 2;
  while (scale < kCoarsest && *middle >= 2 * scale) scale *= 2;
  if (further) {
    if (scale == kCoarsest) return false;
    scale *= 2;
  }
  view_ = shrink(scale);
  scale_ = scale;
  if (view_.empty()) return false;
  return search_within(window_of(kReach), false, kMinContrast);
}

// Averages scale x scale pixels; drops incomplete blocks at the right and bottom.
ImageView PatternSearch::shrink(int scale) {
  const int width = problem_.image.width / scale;
  const int height = problem_.image.height / scale;
  small_image_.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  column_sums_.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(scale));
  const int pixels = scale * scale;
  std::uint8_t* out = small_image_.data();
  for (int y = 0; y < height; ++y) {
    std::fill(column_sums_.begin(), column_sums_.end(), std::uint16_t{0});
    for (int r = 0; r < scale; ++r) {
      const std::uint8_t* const row = problem_.image.row(y * scale + r);
      for (std::size_t x = 0; x < column_sums_.size(); ++x)
        column_sums_[x] = static_cast<std::uint16_t>(column_sums_[x] + row[x]);
    }
    const std::uint16_t* sums = column_sums_.data();
    for (int x = 0; x < width; ++x, sums += scale) {
      int sum = pixels / 2;
      for (int c = 0; c < scale; ++c) sum += sums[c];
      *out++ = static_cast<std::uint8_t>(sum / pixels);
    }
  }
  return {small_image_.data(), width, height, width};
}

// Uses `pairs` white and `pairs` black cells of the tag.
void PatternSearch::find_cell_windows(const AlignedTag& tag, const SearchWindow& window, int pairs,
                                      CellWindows& windows) {
  pairs = std::min(pairs, tag.search_white);
  windows.white = pairs;
  windows.count = 0;
  const int count = 2 * pairs;
  if (count < 4) return;
  std::array<int, kMaxSearchCells> xs;
  std::array<int, kMaxSearchCells> ys;
  const auto smaller = static_cast<float>(1.0 / scale_);
  const ImageView view = view_;  // a copy: stores below can't change it
  const int last_x = view.width - window.columns;
  const int last_y = view.height - window.rows * window.row_step;
  bool within = true;
  int inside = 0;
  // Cell k of a colour is the one with index floor(k * search_white / pairs).
  std::size_t at = 0;
  int remainder = 0;
  const int step = tag.search_white / pairs;
  const int rest = tag.search_white % pairs;
  for (int k = 0; k < pairs; ++k) {
    for (const bool white : {true, false}) {
      const std::size_t point = white ? at : at + static_cast<std::size_t>(tag.search_white);
      float px = tag.search_x[point];
      float py = tag.search_y[point];
      if (scale_ != 1) {
        px = (px + 0.5F) * smaller - 0.5F;
        py = (py + 0.5F) * smaller - 0.5F;
      }
      if (!(tag.search_depth[point] > 0.0F && std::abs(px) < 1e5F && std::abs(py) < 1e5F)) return;
      const int x = floor_of(static_cast<double>(px) + 0.5);
      const int y = floor_of(static_cast<double>(py) + 0.5);
      inside += x >= 0 && y >= 0 && x < view.width && y < view.height ? 1 : 0;
      const auto slot = static_cast<std::size_t>(white ? k : k + pairs);
      xs[slot] = x - window.reach;
      ys[slot] = y + window.first_row;
      within = within && xs[slot] >= 0 && ys[slot] >= 0 && xs[slot] <= last_x && ys[slot] <= last_y;
    }
    at += static_cast<std::size_t>(step);
    remainder += rest;
    if (remainder >= pairs) {
      remainder -= pairs;
      ++at;
    }
  }
  if (2 * inside < count) return;
  windows.count = count;
  const int columns = window.columns;
  const auto size = static_cast<std::size_t>(window.rows * window.row_step * columns);
  std::uint8_t* copy = nullptr;
  if (!within) {
    scratch_.resize(static_cast<std::size_t>(kMaxSearchCells) * size);
    copy = scratch_.data();
  }
  for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
    const int x = xs[k];
    const int y = ys[k];
    if (within || (x >= 0 && y >= 0 && x <= last_x && y <= last_y)) {
      windows.begin[k] = view.row(y) + x;
      windows.stride[k] = view.stride;
      continue;
    }
    // The window exceeds the image: copies it and repeats the border's pixels.
    const int before = std::clamp(-x, 0, columns);
    const int after = std::clamp(x + columns - view.width, 0, columns);
    const int between = columns - before - after;
    for (int r = 0; r < window.rows * window.row_step; r += window.row_step) {
      const std::uint8_t* source = view.row(std::clamp(y + r, 0, view.height - 1));
      std::uint8_t* target = copy + r * columns;
      std::memset(target, source[0], static_cast<std::size_t>(before));
      if (between > 0)
        std::memcpy(target + before, source + x + before, static_cast<std::size_t>(between));
      std::memset(target + columns - after, source[view.width - 1],
                  static_cast<std::size_t>(after));
    }
    windows.begin[k] = copy;
    windows.stride[k] = columns;
    copy += size;
  }
}

// Computes each active tag's score map and their sum; returns the number of cells in the sum.
int PatternSearch::score_tags(const SearchWindow& window) {
  const int pairs = std::clamp(kSearchPoints / (2 * static_cast<int>(problem_.active.size())), 4,
                               kMaxSearchCells / 2);
  const int size = window.size();
  score_sum_.assign(static_cast<std::size_t>(size), 0);
  if (scale_ == 1) prefetch_image(window.reach);
  CellWindows windows;
  int total = 0;
  for (AlignedTag* tag : problem_.active) {
    find_cell_windows(*tag, window, pairs, windows);
    tag->score_points = windows.count;
    if (windows.count == 0) continue;
    tag->scores.resize(static_cast<std::size_t>(size));
    problem_.loops->search(windows.begin.data(), windows.stride.data(), windows.white,
                           windows.count, window.columns, window.rows, window.row_step,
                           tag->scores.data());
    total += windows.count;
    problem_.loops->add(tag->scores.data(), size, score_sum_.data());
  }
  problem_.counters.searched_px += size;
  return total;
}

bool PatternSearch::search_within(const SearchWindow& window, bool independent,
                                  double min_contrast) {
  const double scale = scale_;
  const int total = score_tags(window);
  if (total == 0) return false;
  const auto best = std::max_element(score_sum_.begin(), score_sum_.end()) - score_sum_.begin();
  const int best_row = static_cast<int>(best) / window.columns;
  const int best_column = static_cast<int>(best) % window.columns;
  const double contrast = 2.0 * score_sum_[static_cast<std::size_t>(best)] / total;
  problem_.counters.contrast = contrast;
  if (!independent && contrast < min_contrast) return false;
  // Rejects peaks that may extend beyond the window, except if a cell exceeds the largest window.
  const bool largest = window.reach >= kReach;
  const auto is_unreliable = [&](const PeakCentre& top, double cell_px) {
    if (largest) return top.open && window.holds(cell_px / scale);
    return top.open || !window.holds(displacement(window, top).lpNorm<Eigen::Infinity>());
  };
  double largest_cell_px = 0.0;
  for (const AlignedTag* tag : problem_.active)
    largest_cell_px = std::max(largest_cell_px, tag->cell_max_px);
  const PeakCentre found =
      peak_centre<std::int32_t>(window, score_sum_, best_row, best_column, largest_cell_px / scale);
  if (!largest && is_unreliable(found, largest_cell_px)) return false;
  displaced_.clear();
  const Eigen::Isometry3d T_map_camera = problem_.T_camera_map.inverse();
  for (const AlignedTag* tag : problem_.active) {
    if (tag->score_points == 0) continue;
    const int slack =
        independent ? window.columns : static_cast<int>(std::ceil(tag->cell_px / scale)) + 2;
    const std::optional<TagPeak> peak = find_tag_peak(*tag, window, {best_row, best_column}, slack,
                                                      std::max(kMinContrast, 0.4 * contrast));
    if (!peak) continue;
    const PeakCentre top = peak_centre<std::int16_t>(window, tag->scores, peak->row, peak->column,
                                                     tag->cell_max_px / scale_);
    if (is_unreliable(top, tag->cell_max_px)) continue;
    const Eigen::Vector3d p_camera = tag->centre_point();
    // The centre of a clipped peak is uncertain by up to a cell.
    const double clip_sigma_px = top.open ? tag->cell_max_px / std::sqrt(12.0) : 0.0;
    displaced_.push_back(
        {T_map_camera * p_camera,
         problem_.camera.project_unchecked(p_camera) + scale * displacement(window, top),
         std::hypot(0.4 * scale + 0.1 * tag->cell_px, clip_sigma_px), tag->cell_px, top.open});
  }
  if (displaced_.empty() || !fit_displaced(displaced_, problem_)) return false;
  error_px_ = std::hypot(fit_error_px(displaced_, problem_), kRowGrid * scale * window.row_step);
  return true;
}

// Prefetches the image around the tags, because hardware can't predict the access pattern.
void PatternSearch::prefetch_image(int margin) const {
  float x0 = 1e9F;
  float y0 = 1e9F;
  float x1 = -1e9F;
  float y1 = -1e9F;
  for (const AlignedTag* tag : problem_.active) {
    const std::size_t corners = tag->search_cells.size();
    for (std::size_t k = corners; k < corners + 4; ++k) {
      if (!(tag->search_depth[k] > 0.0F)) continue;
      x0 = std::min(x0, tag->search_x[k]);
      y0 = std::min(y0, tag->search_y[k]);
      x1 = std::max(x1, tag->search_x[k]);
      y1 = std::max(y1, tag->search_y[k]);
    }
  }
  const auto margin_px = static_cast<float>(margin);
  const auto clip = [](float value, int limit) {
    return static_cast<int>(std::clamp(value, 0.0F, static_cast<float>(limit)));
  };
  const int left = clip(x0 - margin_px, problem_.image.width - 1);
  const int right = clip(x1 + margin_px, problem_.image.width - 1);
  const int top = clip(y0 - margin_px, problem_.image.height - 1);
  const int bottom = clip(y1 + margin_px, problem_.image.height - 1);
  for (int y = top; y <= bottom; ++y) {
    const std::uint8_t* row = problem_.image.row(y);
    for (int x = left; x <= right; x += 64) __builtin_prefetch(row + x);
  }
}

}  // namespace penumbra
