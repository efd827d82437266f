// Rasterises the silhouette of projected triangles and computes each cell's distance to its edge.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

namespace penumbra {

// Square cells in the minimum-area rectangle around the points, so the raster rotates with the
// points. The order of the points decides between equal rectangles. Cell (column, row) has
// its centre at (column + 0.5, row + 0.5) in cell coordinates; rows run along the longer side. A
// margin of one empty cell surrounds the silhouette. One object serves many silhouettes and reuses
// its memory.
class FootprintRaster {
 public:
  // Fits a rectangle of about `cell_budget` cells and covers the cells whose centres lie in a face.
  // `points` are finite [m], `faces` three indices each. Returns false if the points have no
  // extent.
  bool cover(std::span<const Eigen::Vector2f> points, std::span<const std::uint32_t> faces,
             int cell_budget);

  // Fills enclosed holes smaller than the fraction `share` of the covered cells.
  void fill_small_holes(double share);

  // Fills gaps of up to `max_gap` cells between two covered cells of a row or column.
  void bridge_gaps(int max_gap);

  // Computes the exact Euclidean distance from each covered cell's centre to the nearest centre of
  // an uncovered cell [cells].
  void compute_depth();

  [[nodiscard]] int width() const { return width_; }    // [cells]
  [[nodiscard]] int height() const { return height_; }  // [cells]
  [[nodiscard]] float cell() const { return cell_; }    // [m]
  [[nodiscard]] std::size_t covered_count() const;
  // Returns the cells of a row: 1 if covered, else 0.
  [[nodiscard]] const float* covered_row(int row) const {
    return covered_.data() + row_offset(row);
  }
  [[nodiscard]] const float* depth_row(int row) const { return depth_.data() + row_offset(row); }
  // Number of cells per row, a multiple of 8. Cells from column width() on are not covered.
  [[nodiscard]] std::size_t stride() const { return stride_; }

  [[nodiscard]] Eigen::Vector2f to_cells(const Eigen::Vector2f& p) const {
    const Eigen::Vector2f d = (p - origin_) / cell_;
    return {axis_.x() * d.x() + axis_.y() * d.y(), axis_.x() * d.y() - axis_.y() * d.x()};
  }
  [[nodiscard]] Eigen::Vector2f from_cells(const Eigen::Vector2f& c) const {
    return origin_ + cell_ * Eigen::Vector2f(axis_.x() * c.x() - axis_.y() * c.y(),
                                             axis_.y() * c.x() + axis_.x() * c.y());
  }

  // Returns the area centroid of the covered cells [m], or the rectangle's centre if there are
  // none.
  [[nodiscard]] Eigen::Vector2f centroid() const;

 private:
  [[nodiscard]] std::size_t row_offset(int row) const {
    return static_cast<std::size_t>(row) * stride_;
  }
  bool fit(std::span<const Eigen::Vector2f> points, int cell_budget);
  void choose_axis(std::span<const Eigen::Vector2f> points, float size);
  void cover_triangle(Eigen::Vector2f a, Eigen::Vector2f b, Eigen::Vector2f c);
  void cover_segment(const Eigen::Vector2f& a, const Eigen::Vector2f& b);
  void cover_cells(int row, std::size_t first, std::size_t end);

  int width_ = 0;
  int height_ = 0;
  std::size_t stride_ = 0;
  float cell_ = 0.0F;                                 // side of a cell [m]
  Eigen::Vector2f origin_ = Eigen::Vector2f::Zero();  // corner of cell (0, 0) [m]
  Eigen::Vector2f axis_ = Eigen::Vector2f::UnitX();   // direction of a row, unit
  std::vector<float> covered_;  // 0 or 1; float so that row sums need no conversion
  std::vector<float> depth_;

  // Scratch memory, kept to avoid allocations.
  struct Run {
    int row, first, last;
    std::uint32_t parent;
    std::uint32_t size;
    bool open;  // touches the raster's border
  };
  std::vector<std::uint64_t> bits_;  // one bit per cell, used by cover(); row_words_ per row
  std::size_t row_words_ = 0;
  std::vector<Eigen::Vector2f> cells_;
  std::vector<Eigen::Vector2f> hull_;
  std::vector<Eigen::Vector2f> hull_candidates_;
  struct Rectangle {
    Eigen::Vector2f along = Eigen::Vector2f::UnitX();
    float width = 0.0F, height = 0.0F;  // along and across [m]
  };
  std::vector<Rectangle> rectangles_;
  std::vector<Run> runs_;
  std::vector<float> squared_column_distance_;
};

}  // namespace penumbra
