// Rasterises triangles on a grid, to compare layers with each other.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// Returns the bounds of points in plane coordinates [m].
[[nodiscard]] Eigen::AlignedBox2f bounds_of(std::span<const PlanePoint> points);

// One bit per cell: whether a triangle covers its centre.
class Coverage {
 public:
  // `low`: the grid's lowest corner in plane coordinates [m]; `cell`: side of a cell [m].
  Coverage(const Eigen::Vector2f& low, float cell, int width, int height);

  // Covers triangles, three points each, of either orientation. Points may lie outside the grid.
  void cover(std::span<const PlanePoint> triangles);
  // Covers the cells whose centres lie in a square around a point [m].
  void cover_square(const PlanePoint& centre, float half_side);

  [[nodiscard]] std::size_t count() const;
  // Counts the cells that are set in both rasters. Here and below, `other` must have the same grid.
  [[nodiscard]] std::size_t count_with(const Coverage& other) const;
  // Returns the intersection over union; 1 if both are empty.
  [[nodiscard]] double iou(const Coverage& other) const;

 private:
  [[nodiscard]] Eigen::Vector2f cells(const PlanePoint& p) const {
    return {(p.u - low_.x()) / cell_, (p.v - low_.y()) / cell_};
  }
  void cover_triangle(Eigen::Vector2f a, Eigen::Vector2f b, Eigen::Vector2f c);
  void fill(int row, int from, int to);

  Eigen::Vector2f low_;
  float cell_;
  int width_, height_;  // [cells]
  std::size_t words_;   // 64-bit words per row
  std::vector<std::uint64_t> bits_;
};

// Returns the intersection over union of two layers, given as triangles of three points each; 1 if
// both are empty.
[[nodiscard]] double layer_iou(std::span<const PlanePoint> a, std::span<const PlanePoint> b);

}  // namespace penumbra
