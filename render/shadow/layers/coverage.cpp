#include "render/shadow/layers/coverage.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace penumbra {

namespace {

constexpr int kComparedCells = 256;  // along a layer's longer side in layer_iou()

float crossing(const Eigen::Vector2f& a, const Eigen::Vector2f& b, float y) {
  return b.y() > a.y() ? a.x() + (b.x() - a.x()) * ((y - a.y()) / (b.y() - a.y())) : b.x();
}

}  // namespace

Eigen::AlignedBox2f bounds_of(std::span<const PlanePoint> points) {
  Eigen::AlignedBox2f box;
  for (const PlanePoint& p : points) box.extend(Eigen::Vector2f(p.u, p.v));
  return box;
}

Coverage::Coverage(const Eigen::Vector2f& low, float cell, int width, int height)
    : low_(low),
      cell_(cell),
      width_(width),
      height_(height),
      words_((static_cast<std::size_t>(width) + 63) / 64),
      bits_(words_ * static_cast<std::size_t>(height), 0) {}

void Coverage::cover(std::span<const PlanePoint> triangles) {
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    cover_triangle(cells(triangles[i]), cells(triangles[i + 1]), cells(triangles[i + 2]));
  }
}

void Coverage::cover_square(const PlanePoint& centre, float half_side) {
  const Eigen::Vector2f at = cells(centre);
  const float half_cells = half_side / cell_;
  const auto first = [](float x) { return std::max(0, static_cast<int>(std::ceil(x - 0.5F))); };
  const auto last = [](float x, int end) {
    return std::min(end - 1, static_cast<int>(std::floor(x - 0.5F)));
  };
  const int from = first(at.x() - half_cells);
  const int to = last(at.x() + half_cells, width_);
  for (int row = first(at.y() - half_cells); row <= last(at.y() + half_cells, height_); ++row) {
    fill(row, from, to);
  }
}

std::size_t Coverage::count() const {
  std::size_t count = 0;
  for (const std::uint64_t word : bits_) count += static_cast<std::size_t>(std::popcount(word));
  return count;
}

std::size_t Coverage::count_with(const Coverage& other) const {
  std::size_t count = 0;
  for (std::size_t i = 0; i < bits_.size(); ++i) {
    count += static_cast<std::size_t>(std::popcount(bits_[i] & other.bits_[i]));
  }
  return count;
}

double Coverage::iou(const Coverage& other) const {
  const std::size_t both = count_with(other);
  const std::size_t any = count() + other.count() - both;
  return any == 0 ? 1.0 : static_cast<double>(both) / static_cast<double>(any);
}

void Coverage::cover_triangle(Eigen::Vector2f a, Eigen::Vector2f b, Eigen::Vector2f c) {
  if (b.y() < a.y()) std::swap(a, b);
  if (c.y() < a.y()) std::swap(a, c);
  if (c.y() < b.y()) std::swap(b, c);
  const int first = std::max(0, static_cast<int>(std::ceil(a.y() - 0.5F)));
  const int last = std::min(height_ - 1, static_cast<int>(std::floor(c.y() - 0.5F)));
  for (int row = first; row <= last; ++row) {
    const float y = static_cast<float>(row) + 0.5F;
    const float x_on_ac = crossing(a, c, y);
    const float x_on_abc = y < b.y() ? crossing(a, b, y) : crossing(b, c, y);
    const int from = std::max(0, static_cast<int>(std::ceil(std::min(x_on_ac, x_on_abc) - 0.5F)));
    const int to =
        std::min(width_ - 1, static_cast<int>(std::floor(std::max(x_on_ac, x_on_abc) - 0.5F)));
    fill(row, from, to);
  }
}

void Coverage::fill(int row, int from, int to) {
  if (from > to) return;
  std::uint64_t* words = bits_.data() + static_cast<std::size_t>(row) * words_;
  const auto first = static_cast<std::size_t>(from) / 64;
  const auto last = static_cast<std::size_t>(to) / 64;
  for (std::size_t word = first; word <= last; ++word) {
    std::uint64_t mask = ~std::uint64_t{0};
    if (word == first) mask &= ~std::uint64_t{0} << (static_cast<unsigned>(from) % 64U);
    if (word == last) mask &= ~std::uint64_t{0} >> (63U - static_cast<unsigned>(to) % 64U);
    words[word] |= mask;
  }
}

double layer_iou(std::span<const PlanePoint> a, std::span<const PlanePoint> b) {
  if (a.empty() && b.empty()) return 1.0;
  const Eigen::AlignedBox2f box = bounds_of(a).merged(bounds_of(b));
  const Eigen::Vector2f size = box.sizes();
  const float longer = size.maxCoeff();
  // All points coincide or exceed the range of floats.
  if (!(longer > 0.0F) || !std::isfinite(longer)) return 1.0;
  const float cell = longer / static_cast<float>(kComparedCells);
  const auto cells = [cell](float length) {
    return std::clamp(static_cast<int>(std::ceil(length / cell)), 1, kComparedCells);
  };
  Coverage first(box.min(), cell, cells(size.x()), cells(size.y()));
  Coverage second = first;
  first.cover(a);
  second.cover(b);
  return first.iou(second);
}

}  // namespace penumbra
