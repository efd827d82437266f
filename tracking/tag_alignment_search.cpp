// The code search: brings the prediction within a cell.

#include "tracking/tag_alignment_state.hpp"

#include <algorithm>
#include <cstring>
#include <limits>

#include "tracking/se3.hpp"
#include "tracking/spd6.hpp"

namespace penumbra {
namespace {

constexpr int kSearchPoints = 256;  // in all
constexpr int kNarrowReach = 15;    // [px]
constexpr int kNearReach = 7;       // [px], for cells that are no larger: a peak is a cell wide
constexpr double kNear_px = 4.0;    // found no further off in the last frame: the near one first
constexpr int kRim_px = 2;          // a peak at the rim of a window may be the flank of another
constexpr int kCoarsest = 16;       // a pixel of the coarse search is so many of the picture's
// The mean white cell over the mean black one [grey]; below this the peak is one of noise.
constexpr double kLeastContrast = 12.0;
// Of the contrast that the tags were found with last: a pattern that is displaced against itself
// shows half of it at most.
constexpr double kAsSeen = 0.75;
constexpr std::size_t kFewestToJudge = 5;  // tags, how well they agree
constexpr double kNearError_px = 0.6;
constexpr double kNearError_cells = 0.15;
constexpr double kFlank = 0.75;  // of a peak's height: what is higher is its top

// Where along a row or a column of a map of scores the middle of the top lies that `at` is on:
// scores[k * step] for k below count. Cells' centres read the same wherever in their cells they
// are, so that the top is as wide as a cell, and noise says where on it the highest place is. A top
// that goes on beyond the map ends with it.
template <class Score>
double middle_of_top(const Score* scores, int step, int count, int at, double level) {
  const auto value = [&](int k) { return static_cast<double>(scores[k * step]); };
  if (!(value(at) >= level)) return at;  // a top that is hollow there
  int first = at;
  while (first > 0 && value(first - 1) >= level) --first;
  int last = at;
  while (last + 1 < count && value(last + 1) >= level) ++last;
  double begin = first;
  double end = last;
  if (first > 0) begin -= (value(first) - level) / (value(first) - value(first - 1));
  if (last + 1 < count) end += (value(last) - level) / (value(last) - value(last + 1));
  return 0.5 * (begin + end);
}

struct Top {
  double row = 0.0;
  double column = 0.0;
};

// The middle of the top about the highest place of a map. A tag that is turned has a top that is,
// so along the row, the column through its middle, and the row through that one's.
template <class Score>
Top top_about(const std::vector<Score>& scores, int rows, int columns, int row, int column) {
  const double level =
      kFlank * static_cast<double>(scores[static_cast<std::size_t>(row * columns + column)]);
  Top top;
  for (int pass = 0; pass < 2; ++pass) {
    top.column = middle_of_top(scores.data() + row * columns, 1, columns, column, level);
    column = static_cast<int>(std::lround(top.column));
    if (pass == 1) break;
    top.row = middle_of_top(scores.data() + column, columns, rows, row, level);
    row = static_cast<int>(std::lround(top.row));
  }
  return top;
}

}  // namespace

// Scores of the data cells' pattern at displacements of the predicted tags, one map per tag; their
// sum tells the common displacement, each map its own tag's near it. The pose is then fitted to the
// tags' displacements, with the prediction's covariance deciding what they leave open.
// `independent`: every tag's own highest peak counts, wherever it is.
bool TagAligner::Impl::search(bool independent) {
  searched = {.view = image, .scale = 1};
  search_error_px = std::numeric_limits<double>::infinity();
  if (independent) return search_within(kSearchReach, true, kLeastContrast);
  // As far as the prediction may be off (3 sigma); where the peak is not well inside, everywhere.
  double sigma_px = 0.0;
  double smallest_cell_px = 1e9;
  for (const Tag* tag : active) {
    smallest_cell_px = std::min(smallest_cell_px, tag->cell_px);
    const double half = 0.5 * (tag->side - 1);
    const Eigen::Vector3d p = tag->ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
    Eigen::Matrix<double, 2, 3> J_p;
    static_cast<void>(camera.project_unchecked(p, &J_p));
    Eigen::Matrix<double, 2, 6> J;
    J << J_p, -J_p * skew(p);
    const Eigen::Matrix2d spread = J * prior_covariance * J.transpose();
    sigma_px = std::max(sigma_px, std::sqrt(std::max(spread(0, 0), spread(1, 1))));
  }
  const double reach = 3.0 * sigma_px + kRim_px;
  for (const int window : {kNearReach, kNarrowReach}) {
    if (window == kNearReach && smallest_cell_px > kNearReach) continue;
    // Most predictions are better than they had to be: where the tags are seen near by as clearly
    // as in the last frame, they are not elsewhere.
    const bool enough = reach <= window;
    const bool likely = options.narrow_search && seen_contrast > 0.0 &&
                        (window == kNarrowReach || seen_off_px <= kNear_px);
    if (!enough && !likely) continue;
    const double least =
        enough ? kLeastContrast : std::max(kAsSeen * seen_contrast, kLeastContrast);
    if (search_within(window, false, least)) return true;
  }
  return search_within(kSearchReach, false, kLeastContrast);
}

// Whether the search left the tags so near that the fine stage, which feels edges over two pixels
// and less where cells are small, finds its way by itself.
bool TagAligner::Impl::found_near() const {
  double smallest_cell_px = 1e9;
  for (const Tag* tag : active) smallest_cell_px = std::min(smallest_cell_px, tag->cell_px);
  return search_error_px <= std::min(kNearError_px, kNearError_cells * smallest_cell_px);
}

// The same in a picture made two to sixteen times smaller, which reaches as many times further, for
// a hand that jerked: the smaller, the further, as long as a cell is left a pixel. From there it is
// some pixels more.
bool TagAligner::Impl::search_coarsely(bool further) {
  std::vector<double> cells;
  cells.reserve(active.size());
  for (const Tag* tag : active) cells.push_back(tag->cell_px);
  const auto middle = cells.begin() + static_cast<std::ptrdiff_t>(cells.size() / 2);
  std::nth_element(cells.begin(), middle, cells.end());
  int scale = 2;
  while (scale < kCoarsest && *middle >= 2 * scale) scale *= 2;
  if (further) {
    if (scale == kCoarsest) return false;
    scale *= 2;
  }
  searched = {.view = shrink(scale), .scale = scale};
  if (searched.view.empty()) return false;
  return search_within(kSearchReach, false, kLeastContrast);
}

// Means of scale x scale pixels; what is left at the right and below is left out.
ImageView TagAligner::Impl::shrink(int scale) {
  const int width = image.width / scale;
  const int height = image.height / scale;
  small_picture.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  column_sums.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(scale));
  const int pixels = scale * scale;
  std::uint8_t* out = small_picture.data();
  for (int y = 0; y < height; ++y) {
    std::fill(column_sums.begin(), column_sums.end(), std::uint16_t{0});
    for (int r = 0; r < scale; ++r) {
      const std::uint8_t* const row = image.row(y * scale + r);
      for (std::size_t x = 0; x < column_sums.size(); ++x)
        column_sums[x] = static_cast<std::uint16_t>(column_sums[x] + row[x]);
    }
    const std::uint16_t* sums = column_sums.data();
    for (int x = 0; x < width; ++x, sums += scale) {
      int sum = pixels / 2;
      for (int c = 0; c < scale; ++c) sum += sums[c];
      *out++ = static_cast<std::uint8_t>(sum / pixels);
    }
  }
  return {small_picture.data(), width, height, width};
}

// The displacements of a search, and the rows of its maps of scores: every row_step-th one.
struct TagAligner::Impl::SearchWindow {
  int reach = 0;  // [pixels of the searched picture]
  int columns = 0;
  int rows = 0;
  int row_step = 1;
  int first_row = 0;  // the displacement of the first one

  [[nodiscard]] Eigen::Vector2d displacement(const Top& top) const {
    return {top.column - reach, first_row + row_step * top.row};
  }
  // Where the flank that begins a peak beyond the window may be.
  [[nodiscard]] bool is_rim(const Eigen::Vector2d& d) const {
    return std::abs(d.x()) + kRim_px > reach || std::abs(d.y()) + kRim_px > -first_row;
  }
};

// Where the window about each of a tag's cells begins in memory, as many white ones as black.
struct TagAligner::Impl::CellWindows {
  std::array<const std::uint8_t*, kMaxSearchCells> begin;
  std::array<std::ptrdiff_t, kMaxSearchCells> stride;
  int white = 0;  // come first
  int count = 0;  // 0: too few of them are seen
};

// Where a search saw a tag.
struct TagAligner::Impl::DisplacedTag {
  Eigen::Vector3d p;  // its centre, in the table frame
  Eigen::Vector2d z;  // that in the image
  double sigma_px;
};

// With many tags a part of each one's cells, `pairs` of a white and a black one, is enough.
void TagAligner::Impl::find_cell_windows(const Tag& tag, const SearchWindow& window, int pairs,
                                         CellWindows& windows) {
  pairs = std::min(pairs, tag.search_white);
  windows.white = pairs;
  windows.count = 0;
  const int count = 2 * pairs;
  if (count < 4) return;
  std::array<int, kMaxSearchCells> xs;
  std::array<int, kMaxSearchCells> ys;
  const auto smaller = static_cast<float>(1.0 / searched.scale);
  const ImageView view = searched.view;  // what is written below is not its size
  const int last_x = view.width - window.columns;
  const int last_y = view.height - window.rows * window.row_step;
  bool complete = true;
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
      if (searched.scale != 1) {
        px = (px + 0.5F) * smaller - 0.5F;
        py = (py + 0.5F) * smaller - 0.5F;
      }
      const bool seen =
          tag.search_depth[point] > 0.0F && std::abs(px) < 1e5F && std::abs(py) < 1e5F;
      complete = complete && seen;
      if (!seen) continue;
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
  if (!complete || 2 * inside < count) return;
  windows.count = count;
  const int columns = window.columns;
  const auto size = static_cast<std::size_t>(window.rows * window.row_step * columns);
  std::uint8_t* copy = nullptr;
  if (!within) {
    search_scratch.resize(static_cast<std::size_t>(kMaxSearchCells) * size);
    copy = search_scratch.data();
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

// Maps of scores of all active tags, and their sum; of how many cells these are.
int TagAligner::Impl::score_tags(const SearchWindow& window) {
  const int pairs =
      std::clamp(kSearchPoints / (2 * static_cast<int>(active.size())), 4, kMaxSearchCells / 2);
  const int size = window.rows * window.columns;
  score_sum.assign(static_cast<std::size_t>(size), 0);
  if (searched.scale == 1) fetch_ahead(window.reach);
  CellWindows windows;
  int total = 0;
  for (Tag* tag : active) {
    find_cell_windows(*tag, window, pairs, windows);
    tag->score_points = windows.count;
    if (windows.count == 0) continue;
    tag->scores.resize(static_cast<std::size_t>(size));
    kernel->search(windows.begin.data(), windows.stride.data(), windows.white, windows.count,
                   window.columns, window.rows, window.row_step, tag->scores.data());
    total += windows.count;
    kernel->add(tag->scores.data(), size, score_sum.data());
  }
  result.counters.searched_points += total;
  result.counters.searched_px += size;
  return total;
}

bool TagAligner::Impl::search_within(int search_reach, bool independent, double least_contrast) {
  const double scale = searched.scale;
  double smallest_cell = 1e9;
  for (const Tag* tag : active) smallest_cell = std::min(smallest_cell, tag->cell_px);
  SearchWindow window;
  window.reach = search_reach;
  window.columns = 2 * (search_reach + 1);
  // The peak is about a cell high to each side.
  window.row_step = std::clamp(static_cast<int>(smallest_cell / scale / 1.75), 1, 4);
  window.rows = 2 * (search_reach / window.row_step) + 1;
  window.first_row = -(search_reach / window.row_step) * window.row_step;
  const int rows = window.rows;
  const int columns = window.columns;
  const int total = score_tags(window);
  if (total == 0) return false;

  const auto best = std::max_element(score_sum.begin(), score_sum.end()) - score_sum.begin();
  const int best_row = static_cast<int>(best) / columns;
  const int best_column = static_cast<int>(best) % columns;
  const double contrast = 2.0 * score_sum[static_cast<std::size_t>(best)] / total;
  result.counters.contrast = contrast;
  if (!independent && contrast < least_contrast) return false;
  const Eigen::Vector2d found =
      window.displacement(top_about(score_sum, rows, columns, best_row, best_column));
  if (!independent && search_reach < kSearchReach && window.is_rim(found)) return false;
  result.counters.found_off_px = scale * found.lpNorm<Eigen::Infinity>();

  std::vector<DisplacedTag> displaced;
  displaced.reserve(active.size());
  const Eigen::Isometry3d T_table_camera = T_camera_table.inverse();
  for (const Tag* tag : active) {
    if (tag->score_points == 0) continue;
    const int slack = independent ? columns : static_cast<int>(std::ceil(tag->cell_px / scale)) + 2;
    const int slack_rows = slack / window.row_step;
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
    const Eigen::Vector2d d =
        window.displacement(top_about(tag->scores, rows, columns, at_row, at_column));
    if (window.is_rim(d)) continue;
    const double half = 0.5 * (tag->side - 1);
    const Eigen::Vector3d p_camera = tag->ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
    const Eigen::Vector2d centre = camera.project_unchecked(p_camera);
    displaced.push_back(
        {T_table_camera * p_camera, centre + scale * d, 0.4 * scale + 0.1 * tag->cell_px});
  }
  return !displaced.empty() && fit_displaced(displaced);
}

// Gauss-Newton on the left perturbation of T_camera_table. The rounds of weights start wide and
// close in, so that a few wrong peaks are left behind.
bool TagAligner::Impl::fit_displaced(const std::vector<DisplacedTag>& displaced) {
  for (int round = 0; round < 4; ++round) {
    const double cutoff = round == 0 ? 1e9 : (round == 1 ? 12.0 : 6.0);
    const Vector6d deviation = log_se3(T_camera_table * T_predicted.inverse());
    Matrix6d H = prior_information;
    Vector6d g = -prior_information * deviation;
    for (const DisplacedTag& d : displaced) {
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
#pragma GCC unroll 6
      for (int row = 0; row < 6; ++row) {
        const double w0 = w * J(0, row);
        const double w1 = w * J(1, row);
#pragma GCC unroll 6
        for (int column = 0; column <= row; ++column)  // the lower triangle is what is read
          H(row, column) += w0 * J(0, column) + w1 * J(1, column);
        g[row] += w0 * r[0] + w1 * r[1];
      }
    }
    const Vector6d xi = solve_spd(H, g);
    if (!xi.allFinite()) return false;
    T_camera_table = exp_se3(xi) * T_camera_table;
  }
  // How far off the tags are left, by how far their tops lie from where the pose has them.
  if (displaced.size() >= kFewestToJudge) {
    double sum2 = 0.0;
    for (const DisplacedTag& d : displaced)
      sum2 += (d.z - camera.project_unchecked(T_camera_table * d.p)).squaredNorm();
    const auto n = static_cast<double>(displaced.size());
    search_error_px = std::sqrt(sum2 / n * 6.0 / (2.0 * n - 6.0));
  }
  return true;
}

// Asks for the image around the tags: it is read in no order that a processor foresees, and a frame
// fresh from a camera or a decoder lies in no near cache.
void TagAligner::Impl::fetch_ahead(int margin) const {
  float x0 = 1e9F;
  float y0 = 1e9F;
  float x1 = -1e9F;
  float y1 = -1e9F;
  for (const Tag* tag : active) {
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
  const int left = clip(x0 - margin_px, image.width - 1);
  const int right = clip(x1 + margin_px, image.width - 1);
  const int top = clip(y0 - margin_px, image.height - 1);
  const int bottom = clip(y1 + margin_px, image.height - 1);
  for (int y = top; y <= bottom; ++y) {
    const std::uint8_t* row = image.row(y);
    for (int x = left; x <= right; x += 64) __builtin_prefetch(row + x);
  }
}

}  // namespace penumbra
