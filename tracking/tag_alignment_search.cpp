// The code search: brings the prediction within a cell.

#include "tracking/tag_alignment_state.hpp"

#include <algorithm>
#include <cstring>

#include "tracking/se3.hpp"
#include "tracking/spd6.hpp"

namespace penumbra {
namespace {

constexpr int kSearchPoints = 256;  // in all
constexpr int kNarrowReach = 15;    // [px]
constexpr int kCoarsest = 16;       // a pixel of the coarse search is so many of the picture's
// The mean white cell over the mean black one [grey]; below this the peak is one of noise.
constexpr double kLeastContrast = 12.0;
// Of the contrast that the tags were found with last: a pattern that is displaced against itself
// shows half of it at most.
constexpr double kAsSeen = 0.75;

}  // namespace

// Scores of the data cells' pattern at displacements of the predicted tags, one map per tag; their
// sum tells the common displacement, each map its own tag's near it. The pose is then fitted to the
// tags' displacements, with the prediction's covariance deciding what they leave open.
// `independent`: every tag's own highest peak counts, wherever it is.
bool TagAligner::Impl::search(bool independent) {
  searched = {.view = image, .scale = 1};
  if (independent) return search_within(kSearchReach, true, kLeastContrast);
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
  if (reach <= kNarrowReach) {
    if (search_within(kNarrowReach, false, kLeastContrast)) return true;
  } else if (options.narrow_search && seen_contrast > 0.0) {
    // Most predictions are better than they had to be: where the tags are seen near by as clearly
    // as in the last frame, they are not elsewhere.
    if (search_within(kNarrowReach, false, std::max(kAsSeen * seen_contrast, kLeastContrast)))
      return true;
  }
  return search_within(kSearchReach, false, kLeastContrast);
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

bool TagAligner::Impl::search_within(int search_reach, bool independent, double least_contrast) {
  const double scale = searched.scale;
  const auto smaller = static_cast<float>(1.0 / scale);
  const int columns = 2 * (search_reach + 1);
  // With many tags a part of each one's cells is enough.
  const int pairs_per_tag =
      std::clamp(kSearchPoints / (2 * static_cast<int>(active.size())), 4, kMaxSearchCells / 2);
  double smallest_cell = 1e9;
  for (const Tag* tag : active) smallest_cell = std::min(smallest_cell, tag->cell_px);
  // The peak is about a cell high to each side.
  const int row_step = std::clamp(static_cast<int>(smallest_cell / scale / 1.75), 1, 4);
  const int rows = 2 * (search_reach / row_step) + 1;
  const int first_row = -(search_reach / row_step) * row_step;
  score_sum.assign(static_cast<std::size_t>(rows * columns), 0);
  if (searched.scale == 1) fetch_ahead(search_reach);
  std::array<const std::uint8_t*, kMaxSearchCells> points{};
  std::array<std::ptrdiff_t, kMaxSearchCells> strides{};
  const int window_rows = rows * row_step;
  const ImageView view = searched.view;  // what is written below is not its size
  int total = 0;
  for (Tag* tag : active) {
    tag->score_points = 0;
    int scratch_used = 0;
    int count = 0;
    int positive = 0;
    bool complete = true;
    int inside = 0;
    const int pairs = std::min(pairs_per_tag, tag->search_white);
    for (int k = 0; k < 2 * pairs; ++k) {
      const int of_colour = k < pairs ? k : k - pairs;
      const auto point = static_cast<std::size_t>((k < pairs ? 0 : tag->search_white) +
                                                  of_colour * tag->search_white / pairs);
      float px = tag->search_x[point];
      float py = tag->search_y[point];
      if (searched.scale != 1) {
        px = (px + 0.5F) * smaller - 0.5F;
        py = (py + 0.5F) * smaller - 0.5F;
      }
      if (!(tag->search_depth[point] > 0.0F && std::abs(px) < 1e5F && std::abs(py) < 1e5F)) {
        complete = false;
        break;
      }
      const int x = floor_of(static_cast<double>(px) + 0.5) - search_reach;
      const int y = floor_of(static_cast<double>(py) + 0.5) + first_row;
      const int cx = x + search_reach;
      const int cy = y - first_row;
      inside += cx >= 0 && cy >= 0 && cx < view.width && cy < view.height ? 1 : 0;
      const auto slot = static_cast<std::size_t>(count);
      if (x >= 0 && y >= 0 && x + columns <= view.width && y + window_rows <= view.height) {
        points[slot] = view.row(y) + x;
        strides[slot] = view.stride;
      } else {
        // The window leaves the image: a copy with the border's pixels repeated.
        search_scratch.resize(static_cast<std::size_t>(kMaxSearchCells * window_rows * columns));
        std::uint8_t* copy =
            search_scratch.data() + static_cast<std::size_t>(scratch_used++) *
                                        static_cast<std::size_t>(window_rows * columns);
        const int before = std::clamp(-x, 0, columns);
        const int after = std::clamp(x + columns - view.width, 0, columns);
        const int within = columns - before - after;
        for (int r = 0; r < window_rows; r += row_step) {
          const std::uint8_t* source = view.row(std::clamp(y + r, 0, view.height - 1));
          std::uint8_t* target = copy + r * columns;
          std::memset(target, source[0], static_cast<std::size_t>(before));
          if (within > 0)
            std::memcpy(target + before, source + x + before, static_cast<std::size_t>(within));
          std::memset(target + columns - after, source[view.width - 1],
                      static_cast<std::size_t>(after));
        }
        points[slot] = copy;
        strides[slot] = columns;
      }
      positive += k < pairs ? 1 : 0;
      ++count;
    }
    if (!complete || 2 * inside < count || count < 4) continue;
    tag->scores.resize(static_cast<std::size_t>(rows * columns));
    kernel->search(points.data(), strides.data(), positive, count, columns, rows, row_step,
                   tag->scores.data());
    tag->score_points = count;
    total += count;
    kernel->add(tag->scores.data(), rows * columns, score_sum.data());
  }
  result.counters.searched_points += total;
  result.counters.searched_px += rows * columns;
  if (total == 0) return false;

  const auto best = std::max_element(score_sum.begin(), score_sum.end()) - score_sum.begin();
  const int best_row = static_cast<int>(best) / columns;
  const int best_column = static_cast<int>(best) % columns;
  const double contrast = 2.0 * score_sum[static_cast<std::size_t>(best)] / total;
  result.counters.contrast = contrast;
  if (!independent && contrast < least_contrast) return false;
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
    const int slack = independent ? columns : static_cast<int>(std::ceil(tag->cell_px / scale)) + 2;
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
    displaced.push_back({T_table_camera * p_camera, centre + scale * Eigen::Vector2d(dx, dy),
                         0.4 * scale + 0.1 * tag->cell_px});
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
