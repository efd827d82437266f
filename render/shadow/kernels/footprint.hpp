// A silhouette as a raster: triangles seen along a direction, and how deep inside each cell lies.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

namespace penumbra {

// Square cells in the least rectangle round the points, so that turning the points turns the raster
// with them. Between equal rectangles the order of the points chooses. Cell (column, row) has its
// centre at (column + 0.5, row + 0.5) in cell coordinates; rows run along the longer side. There is
// an empty margin of one cell on each side. One object serves many silhouettes and keeps its
// memory.
class FootprintRaster {
 public:
  // Fits a rectangle of about `cell_budget` cells and covers those whose centres lie in a face.
  // `points` are finite [m], `faces` three indices each. False where the points have no extent.
  bool cover(std::span<const Eigen::Vector2f> points, std::span<const std::uint32_t> faces,
             int cell_budget);

  // Covers enclosed holes of less than `share` of the covered cells.
  void fill_small_holes(double share);

  // Covers up to `most` cells between two covered ones of a row or column.
  void bridge_gaps(int most);

  // Exact Euclidean distance transform: from the centre of each covered cell to the nearest centre
  // that is not covered [cells].
  void compute_depth();

  [[nodiscard]] int width() const { return width_; }    // [cells]
  [[nodiscard]] int height() const { return height_; }  // [cells]
  [[nodiscard]] float cell() const { return cell_; }    // [m]
  [[nodiscard]] std::size_t covered_count() const;
  // 1 where a cell is covered, else 0.
  [[nodiscard]] const float* covered_row(int row) const {
    return covered_.data() + row_offset(row);
  }
  [[nodiscard]] const float* depth_row(int row) const { return depth_.data() + row_offset(row); }
  // Cells from one row to the next, a multiple of 8; those from width() on are not covered.
  [[nodiscard]] std::size_t stride() const { return stride_; }

  [[nodiscard]] Eigen::Vector2f to_cells(const Eigen::Vector2f& p) const {
    const Eigen::Vector2f d = (p - origin_) / cell_;
    return {axis_.x() * d.x() + axis_.y() * d.y(), axis_.x() * d.y() - axis_.y() * d.x()};
  }
  [[nodiscard]] Eigen::Vector2f from_cells(const Eigen::Vector2f& c) const {
    return origin_ + cell_ * Eigen::Vector2f(axis_.x() * c.x() - axis_.y() * c.y(),
                                             axis_.y() * c.x() + axis_.x() * c.y());
  }

  // Area centroid of the covered cells [m]; the middle of the rectangle where none is covered.
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
  std::vector<float> covered_;  // float, so that sums over rows need no conversion
  std::vector<float> depth_;

  // Scratch, kept to spare allocations.
  struct Run {
    int row, first, last;
    std::uint32_t parent;
    std::uint32_t size;
    bool open;  // reaches the margin
  };
  std::vector<std::uint64_t> bits_;  // cells while faces are covered, row_words_ per row
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
