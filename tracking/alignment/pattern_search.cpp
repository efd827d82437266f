#include "tracking/alignment/pattern_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>

namespace penumbra {
namespace {

constexpr int kSearchPoints = 256;  // in all
constexpr int kNarrowReach = 15;    // [px]
constexpr int kCoarsest = 16;       // the smallest image of the pyramid is this times smaller
// The mean white cell over the mean black one [grey]; below this the peak is one of noise.
constexpr double kLeastContrast = 12.0;
// Share of the contrast that the tags were found with last: a pattern that is displaced against
// itself shows half of it at most.
constexpr double kAsSeen = 0.75;
// Errors from which the fine stage converges.
constexpr double kNearError_px = 1.2;
constexpr double kNearError_cells = 0.2;
// Error of a top's middle by the grid of rows, as a share of the steps between them.
constexpr double kRowGrid = 0.1;

}  // namespace

SearchWindow PatternSearch::window_of(int reach) const {
  // The peak is about a cell high to each side.
  const int row_step =
      std::clamp(static_cast<int>(problem_.smallest_cell_px() / scale_ / 1.75), 1, 4);
  return SearchWindow::of_reach(reach, row_step);
}

bool PatternSearch::search_independently() {
  view_ = problem_.image;
  scale_ = 1;
  error_px_ = std::numeric_limits<double>::infinity();
  return search_within(window_of(kReach), true, kLeastContrast);
}

bool PatternSearch::search(double seen_contrast) {
  view_ = problem_.image;
  scale_ = 1;
  error_px_ = std::numeric_limits<double>::infinity();
  double sigma_px = 0.0;
  double smallest_cell_max_px = 1e9;
  for (const AlignedTag* tag : problem_.active) {
    smallest_cell_max_px = std::min(smallest_cell_max_px, tag->cell_max_px);
    const PointJacobian J = jacobian_at(problem_.camera, tag->centre_point());
    const Eigen::Matrix2d spread = J * problem_.prior_covariance * J.transpose();
    sigma_px = std::max(sigma_px, std::sqrt(std::max(spread(0, 0), spread(1, 1))));
  }
  const SearchWindow narrow = window_of(kNarrowReach);
  if (narrow.holds(0.5 * smallest_cell_max_px)) {  // a top is as wide as a cell
    // Most predictions are better than they had to be: where the tags are seen near by as clearly
    // as in the last frame, they are not elsewhere.
    const bool enough = narrow.holds(3.0 * sigma_px);
    const bool likely = seen_contrast > 0.0;
    const double least =
        enough ? kLeastContrast : std::max(kAsSeen * seen_contrast, kLeastContrast);
    if ((enough || likely) && search_within(narrow, false, least)) return true;
  }
  return search_within(window_of(kReach), false, kLeastContrast);
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
  return search_within(window_of(kReach), false, kLeastContrast);
}

// Averages scale x scale pixels; an incomplete block at the right and below is dropped.
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

// With many tags a part of each one's cells, `pairs` of a white and a black one, is enough.
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
  const ImageView view = view_;  // what is written below is not its size
  const int last_x = view.width - window.columns;
  const int last_y = view.height - window.rows * window.row_step;
  bool within = true;
  int inside = 0;
  // Cell k of `pairs` of a colour is cell floor(k * search_white / pairs) of it.
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
    // The window leaves the image: a copy with the border's pixels repeated.
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

// Computes the maps of scores of all active tags, and their sum; returns the number of cells they
// are of.
int PatternSearch::score_tags(const SearchWindow& window) {
  const int pairs = std::clamp(kSearchPoints / (2 * static_cast<int>(problem_.active.size())), 4,
                               kMaxSearchCells / 2);
  const int size = window.size();
  score_sum_.assign(static_cast<std::size_t>(size), 0);
  if (scale_ == 1) fetch_ahead(window.reach);
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
  problem_.counters.searched_points += total;
  problem_.counters.searched_px += size;
  return total;
}

bool PatternSearch::search_within(const SearchWindow& window, bool independent,
                                  double least_contrast) {
  const double scale = scale_;
  const int total = score_tags(window);
  if (total == 0) return false;
  const auto best = std::max_element(score_sum_.begin(), score_sum_.end()) - score_sum_.begin();
  const int best_row = static_cast<int>(best) / window.columns;
  const int best_column = static_cast<int>(best) % window.columns;
  const double contrast = 2.0 * score_sum_[static_cast<std::size_t>(best)] / total;
  problem_.counters.contrast = contrast;
  if (!independent && contrast < least_contrast) return false;
  // In the largest window there is no other to look in, and of a cell as large as that some of the
  // top is better than nothing.
  const bool largest = window.reach >= kReach;
  const auto elsewhere = [&](const SearchTop& top, double cell_px) {
    if (largest) return top.open && window.holds(cell_px / scale);
    return top.open || !window.holds(window.displacement(top).lpNorm<Eigen::Infinity>());
  };
  double largest_cell_px = 0.0;
  for (const AlignedTag* tag : problem_.active)
    largest_cell_px = std::max(largest_cell_px, tag->cell_max_px);
  const SearchTop found =
      window.top_about(score_sum_, best_row, best_column, largest_cell_px / scale);
  if (!largest && elsewhere(found, largest_cell_px)) return false;
  displaced_.clear();
  const Eigen::Isometry3d T_table_camera = problem_.T_camera_table.inverse();
  for (const AlignedTag* tag : problem_.active) {
    if (tag->score_points == 0) continue;
    const int slack =
        independent ? window.columns : static_cast<int>(std::ceil(tag->cell_px / scale)) + 2;
    const std::optional<OwnPeak> peak = own_peak(*tag, window, {best_row, best_column}, slack,
                                                 std::max(kLeastContrast, 0.4 * contrast));
    if (!peak) continue;
    const SearchTop top =
        window.top_about(tag->scores, peak->row, peak->column, tag->cell_max_px / scale_);
    if (elsewhere(top, tag->cell_max_px)) continue;
    const Eigen::Vector3d p_camera = tag->centre_point();
    // The middle of what is seen of a top that goes on may be off by a part of a cell.
    const double cut_off_px = top.open ? tag->cell_max_px / std::sqrt(12.0) : 0.0;
    displaced_.push_back(
        {T_table_camera * p_camera,
         problem_.camera.project_unchecked(p_camera) + scale * window.displacement(top),
         std::hypot(0.4 * scale + 0.1 * tag->cell_px, cut_off_px), tag->cell_px, top.open});
  }
  if (displaced_.empty() || !fit_displaced(displaced_, problem_)) return false;
  error_px_ = std::hypot(fit_error_px(displaced_, problem_), kRowGrid * scale * window.row_step);
  return true;
}

// Prefetches the image around the tags: it is read in no order that a processor foresees, and a
// frame fresh from a camera or a decoder lies in no near cache.
void PatternSearch::fetch_ahead(int margin) const {
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
