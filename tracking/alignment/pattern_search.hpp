// Brings the prediction within a cell: a translational search for the tags' pattern.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/image/image_view.hpp"
#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/displacement_fit.hpp"
#include "tracking/alignment/search_window.hpp"

namespace penumbra {

// Scores the data cells' pattern at displacements of the predicted tags, one map per tag. The sum
// of the maps gives the common displacement, each map its own tag's displacement near it. The pose
// is then fitted to the tags' displacements.
class PatternSearch {
 public:
  explicit PatternSearch(AlignmentProblem& problem) : problem_(problem) {}

  // Searches as far as the prediction may be off (3 sigma), and everywhere where the pattern is not
  // well inside that. `seen_contrast`: see AlignmentInput.
  [[nodiscard]] bool search(double seen_contrast);
  // The same, where every tag's own highest peak counts, wherever it is.
  [[nodiscard]] bool search_independently();
  // Searches an image two to sixteen times smaller, which reaches as many times further: the
  // smaller, the further, as long as a cell keeps a pixel; `further`: half as large again.
  [[nodiscard]] bool search_pyramid(bool further);

  // How far off the last search put a tag's corner, by how the tags agree [px]; infinite: unknown.
  [[nodiscard]] double error_px() const { return error_px_; }
  // Whether it left the tags so near that the fine stage, which finds edges over two pixels and
  // less where cells are small, needs no wide stage before it.
  [[nodiscard]] bool found_near() const;

 private:
  static constexpr int kReach = 31;  // [px] to each side
  // Where the window about each of a tag's cells begins in memory, as many white ones as black.
  struct CellWindows {
    std::array<const std::uint8_t*, kMaxSearchCells> begin;
    std::array<std::ptrdiff_t, kMaxSearchCells> stride;
    int white = 0;  // come first
    int count = 0;  // 0: too few of them are seen
  };
  [[nodiscard]] SearchWindow window_of(int reach) const;
  void find_cell_windows(const AlignedTag& tag, const SearchWindow& window, int pairs,
                         CellWindows& windows);
  [[nodiscard]] int score_tags(const SearchWindow& window);
  [[nodiscard]] bool search_within(const SearchWindow& window, bool independent,
                                   double least_contrast);
  void fetch_ahead(int margin) const;
  [[nodiscard]] ImageView shrink(int scale);

  AlignmentProblem& problem_;
  ImageView view_;  // what is searched: the image, or one `scale_` times smaller
  int scale_ = 1;
  double error_px_ = std::numeric_limits<double>::infinity();
  std::vector<std::int32_t> score_sum_;
  std::vector<DisplacedTag> displaced_;
  std::vector<std::uint8_t> scratch_;
  std::vector<std::uint8_t> small_image_;
  std::vector<std::uint16_t> column_sums_;
};

}  // namespace penumbra
