// The code search: brings the prediction within a cell.

#include "tracking/alignment/tag_alignment_state.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "tracking/math/se3.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

constexpr int kSearchPoints = 256;  // in all
constexpr int kNarrowReach = 15;    // [px]
constexpr int kRim_px = 2;          // a peak at the rim of a window may be the flank of another
constexpr int kCoarsest = 16;       // a pixel of the coarse search is so many of the picture's
// The mean white cell over the mean black one [grey]; below this the peak is one of noise.
constexpr double kLeastContrast = 12.0;
// Of the contrast that the tags were found with last: a pattern that is displaced against itself
// shows half of it at most.
constexpr double kAsSeen = 0.75;
constexpr std::size_t kFewestToJudge = 5;  // tags: how well they agree
// What the fine stage finds its way from.
constexpr double kNearError_px = 1.2;
constexpr double kNearError_cells = 0.2;
// How far off a top's middle is by the grid of rows, of the steps between them.
constexpr double kRowGrid = 0.1;

}  // namespace

// The displacements of a search, and the rows of its maps of scores: every row_step-th one.
struct TagAligner::Impl::SearchWindow {
  int reach = 0;    // [pixels of the searched picture]
  int columns = 0;  // one more than displacements, which fills the kernel's lanes
  int rows = 0;
  int row_step = 1;
  int first_row = 0;  // the displacement of the first one

  // Whether a peak so far off would be found in it, well inside.
  [[nodiscard]] bool holds(double px) const { return px + kRim_px <= std::min(reach, -first_row); }
  [[nodiscard]] Eigen::Vector2d displacement(const SearchTop& top) const {
    return {top.column - reach, first_row + row_step * top.row};
  }
};

namespace {

// The middle of the top about a map's highest place, of which a cell is `cell` places wide. Cells'
// centres read the same wherever in their cells they are, so that the top is as wide as a cell, and
// noise says where on it the highest place is. What is higher than most of the peak counts alike,
// and its flanks by as much as they reach up: their middle is found between places and rows.
template <class Window, class Score>
SearchTop top_about(const Window& window, const std::vector<Score>& scores, int row, int column,
                    double cell) {
  // Of the peak: a pattern displaced against itself stays under the foot.
  constexpr int kParts = 5;
  constexpr int kFoot = 3;
  constexpr int kShoulder = 4;
  const int last_row = window.rows - 1;
  const int last_column = 2 * window.reach;
  const auto peak =
      static_cast<int>(scores[static_cast<std::size_t>(row * window.columns + column)]);
  if (peak <= 0) return {static_cast<double>(row), static_cast<double>(column), true};
  // Wherever on the top the highest place is, its other end is about a cell away.
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
    const Score* const of_row = scores.data() + static_cast<std::ptrdiff_t>(r) * window.columns;
    int of_places = 0;
    int of_columns = 0;  // from c0
    int highest = 0;
    for (int c = c0; c <= c1; ++c) {
      const int value = of_row[c];
      const int up = std::clamp(value, foot, shoulder) - foot;
      of_places += up;
      of_columns += up * (c - c0);
      highest = std::max(highest, value);
    }
    open = open || ((r == 0 || r == last_row) && highest >= shoulder) ||
           (c0 == 0 && of_row[0] >= shoulder) ||
           (c1 == last_column && of_row[last_column] >= shoulder);
    sum += of_places;
    sum_rows += static_cast<double>(of_places) * r;
    sum_columns += static_cast<double>(of_columns) + static_cast<double>(of_places) * c0;
  }
  if (!(sum > 0.0)) return {static_cast<double>(row), static_cast<double>(column), open};
  return {sum_rows / sum, sum_columns / sum, open};
}

// How a left perturbation of T_camera_table moves the image of a point p of the camera frame.
using Jacobian = Eigen::Matrix<double, 2, 6>;
Jacobian jacobian_of(const Eigen::Matrix<double, 2, 3>& J_p, const Eigen::Vector3d& p) {
  Jacobian J;
  J << J_p, -J_p * skew(p);
  return J;
}
Jacobian jacobian_at(const CameraModel& camera, const Eigen::Vector3d& p) {
  Eigen::Matrix<double, 2, 3> J_p;
  static_cast<void>(camera.project_unchecked(p, &J_p));
  return jacobian_of(J_p, p);
}

// Adds w J^T J to the lower triangle.
void add_point(const Jacobian& J, double w, Matrix6d& H) {
#pragma GCC unroll 6
  for (int row = 0; row < 6; ++row) {
    const double w0 = w * J(0, row);
    const double w1 = w * J(1, row);
#pragma GCC unroll 6
    for (int column = 0; column <= row; ++column)
      H(row, column) += w0 * J(0, column) + w1 * J(1, column);
  }
}

}  // namespace

double TagAligner::Impl::smallest_cell_px() const {
  double smallest = 1e9;
  for (const Tag* tag : active) smallest = std::min(smallest, tag->cell_px);
  return smallest;
}

// In the camera frame.
Eigen::Vector3d TagAligner::Impl::centre_of(const Tag& tag) {
  const double half = 0.5 * (tag.side - 1);
  return tag.ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
}

TagAligner::Impl::SearchWindow TagAligner::Impl::window_of(int reach) const {
  SearchWindow window;
  window.reach = reach;
  window.columns = 2 * (reach + 1);
  // The peak is about a cell high to each side.
  window.row_step = std::clamp(static_cast<int>(smallest_cell_px() / searched.scale / 1.75), 1, 4);
  window.rows = 2 * (reach / window.row_step) + 1;
  window.first_row = -(reach / window.row_step) * window.row_step;
  return window;
}

// Scores of the data cells' pattern at displacements of the predicted tags, one map per tag; their
// sum tells the common displacement, each map its own tag's near it. The pose is then fitted to the
// tags' displacements, with the prediction's covariance deciding what they leave open.
// `independent`: every tag's own highest peak counts, wherever it is.
bool TagAligner::Impl::search(bool independent) {
  searched = {.view = image, .scale = 1};
  search_error_px = std::numeric_limits<double>::infinity();
  if (independent) return search_within(window_of(kSearchReach), true, kLeastContrast);
  // As far as the prediction may be off (3 sigma); where the peak is not well inside, everywhere.
  double sigma_px = 0.0;
  double smallest_cell_max_px = 1e9;
  for (const Tag* tag : active) {
    smallest_cell_max_px = std::min(smallest_cell_max_px, tag->cell_max_px);
    const Jacobian J = jacobian_at(camera, centre_of(*tag));
    const Eigen::Matrix2d spread = J * prior_covariance * J.transpose();
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
  return search_within(window_of(kSearchReach), false, kLeastContrast);
}

// Whether the search left the tags so near that the fine stage, which feels edges over two pixels
// and less where cells are small, finds its way by itself.
bool TagAligner::Impl::found_near() const {
  return search_error_px <= std::min(kNearError_px, kNearError_cells * smallest_cell_px());
}

// The same in a picture made two to sixteen times smaller, which reaches as many times further, for
// a hand that jerked: the smaller, the further, as long as a cell is left a pixel. From there it is
// some pixels more.
bool TagAligner::Impl::search_pyramid(bool further) {
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
  return search_within(window_of(kSearchReach), false, kLeastContrast);
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

// Where the window about each of a tag's cells begins in memory, as many white ones as black.
struct TagAligner::Impl::CellWindows {
  std::array<const std::uint8_t*, kMaxSearchCells> begin;
  std::array<std::ptrdiff_t, kMaxSearchCells> stride;
  int white = 0;  // come first
  int count = 0;  // 0: too few of them are seen
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

bool TagAligner::Impl::search_within(const SearchWindow& window, bool independent,
                                     double least_contrast) {
  const double scale = searched.scale;
  const int total = score_tags(window);
  if (total == 0) return false;
  const auto best = std::max_element(score_sum.begin(), score_sum.end()) - score_sum.begin();
  const int best_row = static_cast<int>(best) / window.columns;
  const int best_column = static_cast<int>(best) % window.columns;
  const double contrast = 2.0 * score_sum[static_cast<std::size_t>(best)] / total;
  result.counters.contrast = contrast;
  if (!independent && contrast < least_contrast) return false;
  // In the largest window there is no other to look in, and of a cell as large as that some of the
  // top is better than nothing.
  const bool largest = window.reach >= kSearchReach;
  const auto elsewhere = [&](const SearchTop& top, double cell_px) {
    if (largest) return top.open && window.holds(cell_px / scale);
    return top.open || !window.holds(window.displacement(top).lpNorm<Eigen::Infinity>());
  };
  double largest_cell_px = 0.0;
  for (const Tag* tag : active) largest_cell_px = std::max(largest_cell_px, tag->cell_max_px);
  const SearchTop found =
      top_about(window, score_sum, best_row, best_column, largest_cell_px / scale);
  if (!largest && elsewhere(found, largest_cell_px)) return false;
  displaced.clear();
  const Eigen::Isometry3d T_table_camera = T_camera_table.inverse();
  for (const Tag* tag : active) {
    if (tag->score_points == 0) continue;
    const int slack =
        independent ? window.columns : static_cast<int>(std::ceil(tag->cell_px / scale)) + 2;
    const std::optional<SearchTop> top = own_top(*tag, window, best_row, best_column, slack,
                                                 std::max(kLeastContrast, 0.4 * contrast));
    if (!top || elsewhere(*top, tag->cell_max_px)) continue;
    const Eigen::Vector3d p_camera = centre_of(*tag);
    // The middle of what is seen of a top that goes on may be off by a part of a cell.
    const double cut_off_px = top->open ? tag->cell_max_px / std::sqrt(12.0) : 0.0;
    displaced.push_back({T_table_camera * p_camera,
                         camera.project_unchecked(p_camera) + scale * window.displacement(*top),
                         std::hypot(0.4 * scale + 0.1 * tag->cell_px, cut_off_px), tag->cell_px,
                         top->open});
  }
  if (displaced.empty() || !fit_displaced()) return false;
  search_error_px = std::hypot(fit_error_px(), kRowGrid * scale * window.row_step);
  return true;
}

// A tag's own top within `slack` of the common one; nothing where it is not seen so clearly, or
// where the highest place is on the flank of what is further off.
std::optional<SearchTop> TagAligner::Impl::own_top(const Tag& tag, const SearchWindow& window,
                                                   int row, int column, int slack,
                                                   double least_contrast) {
  const int columns = window.columns;
  const int last_row = window.rows - 1;
  const int last_column = 2 * window.reach;
  const int slack_rows = slack / window.row_step;
  const int r0 = std::max(row - slack_rows, 0);
  const int r1 = std::min(row + slack_rows, last_row);
  const int c0 = std::max(column - slack, 0);
  const int c1 = std::min(column + slack, last_column);
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
  if (2.0 * score / tag.score_points < least_contrast) return std::nullopt;
  if ((at_row == r0 && r0 > 0 && value(r0 - 1, at_column) > score) ||
      (at_row == r1 && r1 < last_row && value(r1 + 1, at_column) > score) ||
      (at_column == c0 && c0 > 0 && value(at_row, c0 - 1) > score) ||
      (at_column == c1 && c1 < last_column && value(at_row, c1 + 1) > score))
    return std::nullopt;
  return top_about(window, tag.scores, at_row, at_column, tag.cell_max_px / searched.scale);
}

// Gauss-Newton on the left perturbation of T_camera_table. The rounds of weights start wide and
// close in, so that a few wrong peaks are left behind.
bool TagAligner::Impl::fit_displaced() {
  Eigen::Isometry3d T = T_camera_table;
  for (int round = 0; round < 4; ++round) {
    const double cutoff = round == 0 ? 1e9 : (round == 1 ? 12.0 : 6.0);
    const Vector6d deviation = log_se3(T * T_predicted.inverse());
    Matrix6d H = prior_information;
    Vector6d g = -prior_information * deviation;
    for (const DisplacedTag& d : displaced) {
      const Eigen::Vector3d p = T * d.p;
      if (!(p.z() > 0.0)) continue;
      Eigen::Matrix<double, 2, 3> J_p;
      const Eigen::Vector2d r = d.z - camera.project_unchecked(p, &J_p);
      const double t = r.norm() / (d.sigma_px * cutoff);
      if (t >= 1.0) continue;
      const double w = (1.0 - t * t) * (1.0 - t * t) / (d.sigma_px * d.sigma_px);
      const Jacobian J = jacobian_of(J_p, p);
      add_point(J, w, H);
      g += J.transpose() * (w * r);
    }
    const Vector6d xi = solve_spd(H, g);
    if (!xi.allFinite()) return false;
    T = exp_se3(xi) * T;
  }
  T_camera_table = T;
  return true;
}

// How far off the fit may have left a tag's corner, one standard deviation, by how well the tags
// agree and by what the prediction knows of the motions that their centres leave open: those of a
// row of tags about itself, or of what is far from all that were seen. Few tags say little of
// their scatter: it is as if four numbers more had said a twentieth of a cell. Infinite: unknown.
double TagAligner::Impl::fit_error_px() const {
  constexpr double kScatter_cells = 0.05;
  constexpr double kScatterNumbers = 4.0;
  if (displaced.size() < kFewestToJudge) return std::numeric_limits<double>::infinity();
  double sum2 = 0.0;
  double cells = 0.0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  Matrix6d H = Matrix6d::Zero();
  for (const DisplacedTag& d : displaced) {
    if (d.open) return std::numeric_limits<double>::infinity();
    const Eigen::Vector3d p = T_camera_table * d.p;
    Eigen::Matrix<double, 2, 3> J_p;
    sum2 += (d.z - camera.project_unchecked(p, &J_p)).squaredNorm();
    add_point(jacobian_of(J_p, p), 1.0, H);
    cells += d.cell_px;
    middle += d.z;
  }
  const auto n = static_cast<double>(displaced.size());
  middle /= n;
  const double scatter2 = (sum2 + kScatterNumbers * std::pow(kScatter_cells * cells / n, 2)) /
                          (2.0 * n - 6.0 + kScatterNumbers);
  const Matrix6d covariance = inverse_of_spd(H / scatter2 + prior_information);
  double largest2 = 0.0;
  for (const Tag* tag : active) {
    // The corner that is farthest from the middle.
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
    const Eigen::Vector3d p = tag->ray_from_lattice * Eigen::Vector3d(corner % 2 == 0 ? 0.0 : last,
                                                                      corner < 2 ? 0.0 : last, 1.0);
    const Jacobian J = jacobian_at(camera, p);
    largest2 = std::max(largest2, (J * covariance * J.transpose()).trace());
  }
  return std::sqrt(largest2);
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
