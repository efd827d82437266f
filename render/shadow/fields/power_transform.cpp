#include "render/shadow/fields/power_transform.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/vector_clones.hpp"

namespace penumbra {

namespace {

constexpr float kUnreached = std::numeric_limits<float>::infinity();
constexpr std::size_t kBlock = 8;   // cells computed at a time
constexpr std::size_t kStrip = 16;  // columns of a strip: two copies of 256 rows fit into the cache

// Sets values[i] = min(values[i], squares[i] + lift) for at least the first `count` values.
PENUMBRA_VECTOR_CLONES
void lower(float* __restrict values, const float* __restrict squares, std::size_t count,
           float lift) {
  for (std::size_t block = 0; block < count; block += kBlock) {
    for (std::size_t i = block; i < block + kBlock; ++i) {
      const float value = squares[i] + lift;
      values[i] = value < values[i] ? value : values[i];
    }
  }
}

// In each step, sets each cell to min(itself, its neighbours in the column + 2 step - 1). `from`
// and `to` have a row of infinity before and after the `count` cells. Returns the buffer with the
// result.
PENUMBRA_VECTOR_CLONES
float* spread_columns(float* from, float* to, std::size_t count, int steps) {
  for (int step = 1; step <= steps; ++step) {
    const auto rise = static_cast<float>(2 * step - 1);
    const float* before = from - kStrip;
    const float* after = from + kStrip;
#pragma GCC ivdep  // two arrays
    for (std::size_t i = 0; i < count; ++i) {
      const float beside = (before[i] < after[i] ? before[i] : after[i]) + rise;
      to[i] = beside < from[i] ? beside : from[i];
    }
    std::swap(from, to);
  }
  return from;
}

// Copies a strip of columns from the rows.
PENUMBRA_VECTOR_CLONES
void load_strip(const float* __restrict values, std::size_t stride, std::size_t height,
                float* __restrict strip) {
  for (std::size_t i = 0; i < height; ++i) {
    const float* from = values + i * stride;
    float* to = strip + i * kStrip;
    for (std::size_t j = 0; j < kStrip; ++j) to[j] = from[j];
  }
}

// Copies the strip back; values greater than the bound become kFar.
PENUMBRA_VECTOR_CLONES
void store_strip(const float* __restrict strip, std::size_t stride, std::size_t height, float bound,
                 float* __restrict values) {
  for (std::size_t i = 0; i < height; ++i) {
    const float* from = strip + i * kStrip;
    float* to = values + i * stride;
    for (std::size_t j = 0; j < kStrip; ++j) {
      to[j] = from[j] <= bound ? from[j] : PowerTransform::kFar;
    }
  }
}

}  // namespace

void PowerTransform::start(int width, int height) {
  width_ = width;
  height_ = height;
  stride_ = (static_cast<std::size_t>(width) + 2 * kStrip - 1) / kStrip * kStrip;
  sites_.clear();
}

void PowerTransform::run() {
  const auto height = static_cast<std::size_t>(height_);
  values_.assign(stride_ * height, kUnreached);
  float largest = 0.0F;
  for (const Site& site : sites_) largest = std::max(largest, site.radius);
  // A cell next to a disc's outline is within sqrt(2) of it: (r + sqrt(2))^2 - r^2 = 2.83 r + 2.
  bound_ = 3.0F * largest + 3.0F;
  // A disc larger than the raster covers all of it.
  const auto extent_of = [this](float radius) {
    return static_cast<int>(std::min(std::sqrt(radius * radius + bound_),
                                     static_cast<float>(std::max(width_, height_)))) +
           1;
  };
  const int max_extent = extent_of(largest);
  if (max_extent > squares_reach_) {
    squares_reach_ = max_extent;
    squares_.resize(2 * static_cast<std::size_t>(max_extent) + 1 + kBlock);
    for (std::size_t i = 0; i < squares_.size(); ++i) {
      const float d = static_cast<float>(i) - static_cast<float>(max_extent);
      squares_[i] = d * d;
    }
  }
  for (const Site& site : sites_) {
    const int extent = extent_of(site.radius);
    const int first = std::max(0, site.column - extent);
    const int end = std::min(width_, site.column + extent + 1);
    lower(values_.data() + static_cast<std::size_t>(site.row) * stride_ +
              static_cast<std::size_t>(first),
          squares_.data() + (first - site.column + squares_reach_),
          static_cast<std::size_t>(end - first), -site.radius * site.radius);
  }

  const std::size_t count = kStrip * height;
  const std::size_t strip_size = count + 2 * kStrip;
  strips_.resize(2 * strip_size);
  for (std::size_t copy = 0; copy < 2; ++copy) {
    float* strip = strips_.data() + copy * strip_size;
    std::fill_n(strip, kStrip, kUnreached);
    std::fill_n(strip + kStrip + count, kStrip, kUnreached);
  }
  float* strip = strips_.data() + kStrip;
  const int steps = std::min(max_extent, height_ - 1);
  for (std::size_t left = 0; left < static_cast<std::size_t>(width_); left += kStrip) {
    load_strip(values_.data() + left, stride_, height, strip);
    const float* spread = spread_columns(strip, strip + strip_size, count, steps);
    store_strip(spread, stride_, height, bound_, values_.data() + left);
  }
}

}  // namespace penumbra
