// Brings the prediction within a cell: a translational search for the tags' pattern.
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

// The displacements of a search; score maps have every row_step-th row.
struct SearchWindow {
  static constexpr int kRim_px = 2;  // a peak at the rim of a window may be the flank of another

  SearchWindow(int reach_, int row_step_)
      : reach(reach_),
        columns(2 * (reach + 1)),
        rows(2 * (reach_ / row_step_) + 1),
        row_step(row_step_),
        first_row(-(reach_ / row_step_) * row_step_) {}

  int reach;    // [pixels of the searched image]
  int columns;  // one more than displacements, which fills the lanes of the SIMD loops
  int rows;
  int row_step;
  int first_row;  // displacement of the first row

  [[nodiscard]] int size() const { return rows * columns; }
  // Returns true if a peak at this distance is well inside the window.
  [[nodiscard]] bool holds(double px) const { return px + kRim_px <= std::min(reach, -first_row); }
};

// Position at which a search found a tag.
struct DisplacedTag {
  Eigen::Vector3d p;  // the tag's centre, in the map's frame
  Eigen::Vector2d z;  // that in the image
  double sigma_px = 0.0;
  double cell_px = 0.0;
  bool open = false;  // its peak may continue beyond the searched window
};

// Scores the data cells' pattern at displacements of the predicted tags, one map per tag, and fits
// the pose to the displacements of the peaks.
class PatternSearch {
 public:
  explicit PatternSearch(AlignmentProblem& problem) : problem_(problem) {}

  // Searches within 3 sigma of the prediction, then in the largest window unless the pattern is
  // well inside. `seen_contrast`: see AlignmentInput. False where nothing is found.
  [[nodiscard]] bool search(double seen_contrast);
  // Searches the largest window for every tag independently.
  [[nodiscard]] bool search_independently();
  // Searches an image so much smaller that a cell keeps a pixel; `further`: half of that.
  [[nodiscard]] bool search_pyramid(bool further);

  // Error of the last search at a tag's corner, by the scatter of the tags [px]; infinite: unknown.
  [[nodiscard]] double error_px() const { return error_px_; }
  // Returns true if the last search ended so near that the fine stage needs no wide stage.
  [[nodiscard]] bool found_near() const;

 private:
  static constexpr int kReach = 31;  // [px] to each side
  // Begin in memory of the window about each of a tag's cells, as many white ones as black.
  struct CellWindows {
    std::array<const std::uint8_t*, kMaxSearchCells> begin;
    std::array<std::ptrdiff_t, kMaxSearchCells> stride;
    int white = 0;  // the first ones
    int count = 0;  // 0: too few of them are seen
  };
  void begin_full_size();
  [[nodiscard]] SearchWindow window_of(int reach) const;
  void find_cell_windows(const AlignedTag& tag, const SearchWindow& window, int pairs,
                         CellWindows& windows);
  [[nodiscard]] int score_tags(const SearchWindow& window);
  [[nodiscard]] bool search_within(const SearchWindow& window, bool independent,
                                   double least_contrast);
  void fetch_ahead(int margin) const;
  [[nodiscard]] ImageView shrink(int scale);

  AlignmentProblem& problem_;
  ImageView view_;  // the image, or one `scale_` times smaller
  int scale_ = 1;
  double error_px_ = std::numeric_limits<double>::infinity();
  std::vector<std::int32_t> score_sum_;
  std::vector<DisplacedTag> displaced_;
  std::vector<std::uint8_t> scratch_;
  std::vector<std::uint8_t> small_image_;
  std::vector<std::uint16_t> column_sums_;
};

}  // namespace penumbra
