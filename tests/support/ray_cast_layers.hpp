// Shadows of area lights at the zenith by ray casting, as reference for the layers of kernels and
// fields. A ray leads from each pixel to each of many points of the light. All rays to one point
// are parallel, so they are cast together: a face projected along the rays covers the pixels whose
// rays it blocks.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <span>
#include <vector>

#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra::test {

// A square bitmap on the plane, one bit per pixel. A pixel is set if its centre is covered.
class PlaneBits {
 public:
  // The corner of pixel (0, 0), and the side [m].
  PlaneBits(const Eigen::Vector2d& corner, double side, int pixels)
      : corner_(corner),
        pixel_(side / pixels),
        size_(pixels),
        words_((static_cast<std::size_t>(pixels) + 63) / 64),
        bits_(words_ * static_cast<std::size_t>(pixels), 0) {}

  void cover(const std::array<Eigen::Vector2d, 3>& corners) {
    std::array<Eigen::Vector2d, 3> p;
    for (std::size_t i = 0; i < 3; ++i) p[i] = (corners[i] - corner_) / pixel_;
    const double low = std::min({p[0].y(), p[1].y(), p[2].y()});
    const double high = std::max({p[0].y(), p[1].y(), p[2].y()});
    const int last = std::min(size_ - 1, static_cast<int>(std::floor(high - 0.5)));
    for (int row = std::max(0, static_cast<int>(std::ceil(low - 0.5))); row <= last; ++row) {
      const double y = row + 0.5;
      double left = size_, right = -1.0;
      for (std::size_t i = 0; i < 3; ++i) {
        const Eigen::Vector2d &a = p[i], &b = p[(i + 1) % 3];
        if ((a.y() <= y) == (b.y() <= y)) continue;
        const double x = a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
        left = std::min(left, x);
        right = std::max(right, x);
      }
      set(row, std::max(0, static_cast<int>(std::ceil(left - 0.5))),
          std::min(size_ - 1, static_cast<int>(std::floor(right - 0.5))));
    }
  }
  void cover(std::span<const PlanePoint> triangles) {
    const auto at = [&](std::size_t i) {
      return Eigen::Vector2d(static_cast<double>(triangles[i].u),
                             static_cast<double>(triangles[i].v));
    };
    for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) cover({at(i), at(i + 1), at(i + 2)});
  }
  // Sets the pixels whose centres satisfy a predicate.
  template <class Predicate>
  void cover_where(const Predicate& is_covered) {
    for (int row = 0; row < size_; ++row) {
      for (int column = 0; column < size_; ++column) {
        if (is_covered(
                Eigen::Vector2d(corner_ + pixel_ * Eigen::Vector2d(column + 0.5, row + 0.5))))
          set(row, column, column);
      }
    }
  }
  [[nodiscard]] bool at(int column, int row) const {
    const auto x = static_cast<std::size_t>(column);
    return (bits_[static_cast<std::size_t>(row) * words_ + x / 64] >> (x % 64) & 1U) != 0;
  }

  void unite(const PlaneBits& other) {
    for (std::size_t i = 0; i < bits_.size(); ++i) bits_[i] |= other.bits_[i];
  }
  void intersect(const PlaneBits& other) {
    for (std::size_t i = 0; i < bits_.size(); ++i) bits_[i] &= other.bits_[i];
  }
  [[nodiscard]] double area() const {  // [m^2]
    std::size_t count = 0;
    for (const std::uint64_t word : bits_) count += static_cast<std::size_t>(std::popcount(word));
    return static_cast<double>(count) * pixel_ * pixel_;
  }
  // Intersection over union; 1 if both are empty.
  [[nodiscard]] double iou(const PlaneBits& other) const {
    std::size_t both = 0, either = 0;
    for (std::size_t i = 0; i < bits_.size(); ++i) {
      both += static_cast<std::size_t>(std::popcount(bits_[i] & other.bits_[i]));
      either += static_cast<std::size_t>(std::popcount(bits_[i] | other.bits_[i]));
    }
    return either == 0 ? 1.0 : static_cast<double>(both) / static_cast<double>(either);
  }

 private:
  void set(int row, int first, int last) {  // columns; last is inclusive
    if (first > last) return;
    std::uint64_t* words = bits_.data() + static_cast<std::size_t>(row) * words_;
    for (int word = first / 64; word <= last / 64; ++word) {
      std::uint64_t mask = ~std::uint64_t{0};
      if (word == first / 64) mask &= ~std::uint64_t{0} << (first % 64);
      if (word == last / 64) mask &= ~std::uint64_t{0} >> (63 - last % 64);
      words[word] |= mask;
    }
  }

  Eigen::Vector2d corner_;
  double pixel_;
  int size_;
  std::size_t words_;  // per row
  std::vector<std::uint64_t> bits_;
};

struct PlaneLayers {
  PlaneBits umbra, middle, penumbra;
};

// Returns `inside` points spread over the unit disc (a sunflower; the centre comes first) and then
// `on_rim` points of its rim.
inline std::vector<Eigen::Vector2d> light_points(int inside, int on_rim) {
  std::vector<Eigen::Vector2d> points;
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  for (int i = 0; i < inside; ++i) {
    const double r = std::sqrt(static_cast<double>(i) / std::max(1, inside - 1));
    points.emplace_back(r * std::cos(golden * i), r * std::sin(golden * i));
  }
  for (int i = 0; i < on_rim; ++i) {
    const double turn = 2.0 * std::numbers::pi * i / on_rim;
    points.emplace_back(std::cos(turn), std::sin(turn));
  }
  return points;
}

// Casts the shadows of all parts, each with its own light. `slopes`: radius of the light over its
// height, by part. `vertices`: on and above the plane. `empty`: gives the grid.
inline PlaneLayers ray_cast_layers(std::span<const CasterVertex> vertices,
                                   std::span<const std::uint32_t> indices,
                                   std::span<const std::uint32_t> part,
                                   std::span<const double> slopes, const PlaneBits& empty,
                                   std::span<const Eigen::Vector2d> light) {
  PlaneLayers layers{empty, empty, empty};
  for (std::size_t which = 0; which < slopes.size(); ++which) {
    PlaneLayers of_part{empty, empty, empty};
    for (std::size_t point = 0; point < light.size(); ++point) {
      PlaneBits blocked = empty;
      for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
        if (part[indices[i]] != which) continue;
        std::array<Eigen::Vector2d, 3> corners;
        for (std::size_t c = 0; c < 3; ++c) {
          const CasterVertex& vertex = vertices[indices[i + c]];
          corners[c] =
              Eigen::Vector2d(static_cast<double>(vertex.u), static_cast<double>(vertex.v)) -
              slopes[which] * static_cast<double>(vertex.h) * light[point];
        }
        blocked.cover(corners);
      }
      if (point == 0) {
        of_part.umbra = blocked;
        of_part.middle = blocked;
      }
      of_part.umbra.intersect(blocked);
      of_part.penumbra.unite(blocked);
    }
    layers.umbra.unite(of_part.umbra);
    layers.middle.unite(of_part.middle);
    layers.penumbra.unite(of_part.penumbra);
  }
  return layers;
}

}  // namespace penumbra::test
