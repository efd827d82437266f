// Translational search for the tags' pattern. Corrects the prediction to within a cell.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/image/image_view.hpp"
#include "tracking/alignment/alignment_problem.hpp"

namespace penumbra {

// Range of displacements of a search. Score maps contain every row_step-th row.
struct SearchWindow {
  static constexpr int kRim_px = 2;  // a maximum at the rim may be the flank of a peak outside

  SearchWindow(int reach_, int row_step_)
      : reach(reach_),
        columns(2 * (reach + 1)),
        rows(2 * (reach_ / row_step_) + 1),
        row_step(row_step_),
        first_row(-(reach_ / row_step_) * row_step_) {}

  int reach;    // [pixels of the searched image]
  int columns;  // one more than displacements, to fill the SIMD lanes
  int rows;
  int row_step;
  int first_row;  // vertical displacement of the first row

  [[nodiscard]] int size() const { return rows * columns; }
  // Returns true if a peak at this distance is inside the window's rim.
  [[nodiscard]] bool holds(double px) const { return px + kRim_px <= std::min(reach, -first_row); }
};

// Position of a tag that a search found.
struct DisplacedTag {
  Eigen::Vector3d p;  // the tag's centre in the map frame [m]
  Eigen::Vector2d z;  // the pixel at which the search found the centre
  double sigma_px = 0.0;
  double cell_px = 0.0;
  bool open = false;  // the peak may extend beyond the searched window
};

// Scores the data cells' pattern at displacements of the predicted tags (one map per tag) and fits
// the pose to the peaks.
class PatternSearch {
 public:
  explicit PatternSearch(AlignmentProblem& problem) : problem_(problem) {}

  // Searches a narrow window (if it holds 3 sigma of the prediction, or if `previous_contrast`, see
  // AlignmentInput, is known) and, failing that, the largest. Returns false if nothing is found.
  [[nodiscard]] bool search(double previous_contrast);
  // Searches the largest window for each tag independently.
  [[nodiscard]] bool search_independently();
  // Searches a reduced image in which a cell is 1 to 2 px wide; `further`: half of that.
  [[nodiscard]] bool search_pyramid(bool further);

  // Returns the error (1 sigma) of the latest search at the worst tag corner [px], estimated from
  // the scatter of the tags; infinite if unknown.
  [[nodiscard]] double error_px() const { return error_px_; }
  // Returns true if the latest search was so accurate that the wide stage can be skipped.
  [[nodiscard]] bool found_near() const;

 private:
  static constexpr int kReach = 31;  // [px] in each direction
  // Addresses of the search windows of one tag's cells, as many white as black ones.
  struct CellWindows {
    std::array<const std::uint8_t*, kMaxSearchCells> begin;
    std::array<std::ptrdiff_t, kMaxSearchCells> stride;
    int white = 0;  // number of white cells, which come first
    int count = 0;  // 0: too few cells are visible
  };
  void begin_full_size();
  [[nodiscard]] SearchWindow window_of(int reach) const;
  void find_cell_windows(const AlignedTag& tag, const SearchWindow& window, int pairs,
                         CellWindows& windows);
  [[nodiscard]] int score_tags(const SearchWindow& window);
  [[nodiscard]] bool search_within(const SearchWindow& window, bool independent,
                                   double min_contrast);
  void prefetch_image(int margin) const;
  [[nodiscard]] ImageView shrink(int scale);

  AlignmentProblem& problem_;
  ImageView view_;  // the image, or the image reduced by `scale_`
  int scale_ = 1;
  double error_px_ = std::numeric_limits<double>::infinity();
  std::vector<std::int32_t> score_sum_;
  std::vector<DisplacedTag> displaced_;
  std::vector<std::uint8_t> scratch_;
  std::vector<std::uint8_t> small_image_;
  std::vector<std::uint16_t> column_sums_;
};

}  // namespace penumbra
