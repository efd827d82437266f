#include "render/shadow/kernels/silhouette_discs.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/vector_clones.hpp"
#include "render/shadow/casters/set_flags.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kDiscBlock = 16;  // discs tested at once
// Squared relative distances that differ by no more than this factor and this addend are equal, so
// that rounding does not choose between the two sides of a symmetric shape.
constexpr float kMaxEqualRatio = 1.001F;
constexpr float kEqualTolerance = 1e-6F;

// Writes the depth of ridge cells, 0 for others, and flags ridge cells. A row and a cell must exist
// before and after the `count` cells.
PENUMBRA_VECTOR_CLONES
void find_ridge(const float* depths, std::ptrdiff_t stride, std::size_t count, float slope,
                float* __restrict ridge, std::uint8_t* __restrict flags) {
  const float diagonal_slope = slope * 1.41421356F;
  const float* above = depths - stride;
  const float* below = depths + stride;
  const float* left = depths - 1;
  const float* right = depths + 1;
  const float* above_left = above - 1;
  const float* above_right = above + 1;
  const float* below_left = below - 1;
  const float* below_right = below + 1;
  for (std::size_t x = 0; x < count; ++x) {
    const float beside = left[x] > right[x] ? left[x] : right[x];
    const float upright = above[x] > below[x] ? above[x] : below[x];
    const float straight = beside > upright ? beside : upright;
    const float upper = above_left[x] > above_right[x] ? above_left[x] : above_right[x];
    const float lower = below_left[x] > below_right[x] ? below_left[x] : below_right[x];
    const float diagonal = upper > lower ? upper : lower;
    const float depth = depths[x];
    const bool on_ridge =
        (depth > 0.0F) & (depth + slope > straight) & (depth + diagonal_slope > diagonal);
    ridge[x] = on_ridge ? depth : 0.0F;
    flags[x] = on_ridge ? 1 : 0;
  }
}

// Returns the first block from `block` on in which a disc reaches the point, or `blocks`.
PENUMBRA_VECTOR_CLONES
std::size_t first_reaching_block(const float* x, const float* y, const float* squared_reach,
                                 std::size_t block, std::size_t blocks, float to_x, float to_y) {
  for (; block < blocks; ++block) {
    std::int32_t reached = 0;
    for (std::size_t i = block * kDiscBlock; i < (block + 1) * kDiscBlock; ++i) {
      const float dx = x[i] - to_x;
      const float dy = y[i] - to_y;
      reached |= dx * dx + dy * dy <= squared_reach[i] ? 1 : 0;
    }
    if (reached != 0) break;
  }
  return block;
}

// Writes (distance / radius)^2 of a point to each disc's centre; infinity if the disc does not
// reach it. Values are bit patterns of floats, which compare like the floats. Returns the minimum.
PENUMBRA_VECTOR_CLONES
std::int32_t relative_distances(const float* x, const float* y, const float* squared_reach,
                                const float* squared_radius, std::size_t count, float to_x,
                                float to_y, std::int32_t* __restrict distances) {
  std::int32_t min_distance = std::bit_cast<std::int32_t>(std::numeric_limits<float>::infinity());
  for (std::size_t i = 0; i < count; ++i) {
    const float dx = x[i] - to_x;
    const float dy = y[i] - to_y;
    const float squared = dx * dx + dy * dy;
    const float in_radii = squared / squared_radius[i];
    const auto distance = std::bit_cast<std::int32_t>(
        squared <= squared_reach[i] ? in_radii : std::numeric_limits<float>::infinity());
    distances[i] = distance;
    min_distance = distance < min_distance ? distance : min_distance;
  }
  return min_distance;
}

// The middle of a ridge that covers several of the 3 x 3 cells around a cell (index bits: row by
// row from the lower left): its offset from the central cell, and its additional depth.
struct RidgeMiddle {
  float x = 0.0F, y = 0.0F, deeper = 0.0F;  // [cells]
};
const std::array<RidgeMiddle, 512>& ridge_middles() {
  static const std::array<RidgeMiddle, 512> table = [] {
    std::array<RidgeMiddle, 512> middles;
    for (unsigned cells = 1; cells < middles.size(); ++cells) {
      RidgeMiddle& middle = middles[cells];
      for (unsigned cell = 0; cell < 9; ++cell) {
        if ((cells >> cell & 1U) == 0) continue;
        middle.x += static_cast<float>(cell % 3) - 1.0F;
        middle.y += static_cast<float>(cell / 3) - 1.0F;
      }
      const auto count = static_cast<float>(std::popcount(cells));
      middle.x /= count;
      middle.y /= count;
      middle.deeper = std::sqrt(middle.x * middle.x + middle.y * middle.y);
    }
    return middles;
  }();
  return table;
}

}  // namespace

void ReachingDiscs::set_reach(float times, float slack) {
  const std::size_t padded = (discs_.size() + kDiscBlock - 1) / kDiscBlock * kDiscBlock;
  for (std::vector<float>* values : {&x_, &y_, &squared_reach_, &squared_radius_})
    values->resize(padded);
  distances_.resize(padded);
  for (std::size_t i = 0; i < discs_.size(); ++i) {
    const float reach = times * discs_[i].radius + slack;
    x_[i] = discs_[i].x;
    y_[i] = discs_[i].y;
    squared_reach_[i] = reach * reach;
    squared_radius_[i] = discs_[i].radius * discs_[i].radius;
  }
  for (std::size_t i = discs_.size(); i < padded; ++i) {
    x_[i] = y_[i] = 0.0F;
    squared_reach_[i] = -1.0F;
    squared_radius_[i] = 1.0F;
  }
}

bool ReachingDiscs::reaches(std::size_t disc, float x, float y) const {
  const float dx = x_[disc] - x;
  const float dy = y_[disc] - y;
  return dx * dx + dy * dy <= squared_reach_[disc];
}

std::size_t ReachingDiscs::next_reaching(std::size_t disc, float x, float y) const {
  for (; disc < discs_.size() && disc % kDiscBlock != 0; ++disc) {
    if (reaches(disc, x, y)) return disc;
  }
  if (disc >= discs_.size()) return discs_.size();
  const std::size_t block = first_reaching_block(x_.data(), y_.data(), squared_reach_.data(),
                                                 disc / kDiscBlock, x_.size() / kDiscBlock, x, y);
  disc = block * kDiscBlock;
  while (disc < discs_.size() && !reaches(disc, x, y)) ++disc;
  return std::min(disc, discs_.size());
}

std::size_t ReachingDiscs::nearest(std::size_t first, std::size_t end, float x, float y) {
  const std::int32_t min_distance =
      relative_distances(x_.data() + first, y_.data() + first, squared_reach_.data() + first,
                         squared_radius_.data() + first, end - first, x, y, distances_.data());
  const float limit = std::bit_cast<float>(min_distance) * kMaxEqualRatio + kEqualTolerance;
  const auto found = std::ranges::find_if(
      distances_, [limit](std::int32_t bits) { return std::bit_cast<float>(bits) <= limit; });
  return first + static_cast<std::size_t>(found - distances_.begin());
}

void RidgeDiscs::find(const FootprintRaster& raster, float slope, ReachingDiscs& discs) {
  const std::size_t stride = raster.stride();
  const auto height = static_cast<std::size_t>(raster.height());
  ridge_.resize(stride * height);
  flags_.resize(stride * height);
  // The margin has no ridge cells.
  const std::size_t first = stride + 1;
  const std::size_t last = stride * (height - 1) - 1;
  const auto clear = [](auto& values, std::size_t begin, std::size_t end) {
    std::fill(values.begin() + static_cast<std::ptrdiff_t>(begin),
              values.begin() + static_cast<std::ptrdiff_t>(end), 0);
  };
  clear(ridge_, 0, first);
  clear(flags_, 0, first);
  find_ridge(raster.depth_row(0) + first, static_cast<std::ptrdiff_t>(stride), last - first, slope,
             ridge_.data() + first, flags_.data() + first);
  clear(ridge_, last, ridge_.size());
  clear(flags_, last, flags_.size());
  found_.clear();
  for (std::size_t row = 1; row + 1 < height; ++row) {
    for_each_set(std::span(flags_).subspan(row * stride, stride), [&](std::size_t column) {
      found_.push_back(disc_at(column, row, stride, slope));
    });
  }
  sort(discs);
}

Disc RidgeDiscs::disc_at(std::size_t column, std::size_t row, std::size_t stride,
                         float slope) const {
  // A ridge between two rows appears in both, so its middle is the mean of the adjacent cells of
  // about equal depth. Otherwise the kernel would be off by half a cell.
  const float* ridge = ridge_.data() + (row - 1) * stride + column - 1;
  const float depth = ridge[stride + 1];
  unsigned same_ridge = 0;
  for (unsigned y = 0; y < 3; ++y) {
    for (unsigned x = 0; x < 3; ++x) {
      const float difference = ridge[y * stride + x] - depth;
      same_ridge |= static_cast<unsigned>(std::abs(difference) <= slope) << (3 * y + x);
    }
  }
  const RidgeMiddle& middle = ridge_middles()[same_ridge];
  // The outline is half a cell before the nearest uncovered centre.
  return {static_cast<float>(column) + 0.5F + middle.x, static_cast<float>(row) + 0.5F + middle.y,
          depth - 0.5F + middle.deeper};
}

// Bucket sort by radius. Radii are positive, so their bit patterns compare like the radii.
void RidgeDiscs::sort(ReachingDiscs& discs) {
  discs.clear();
  if (found_.empty()) return;
  const float largest = std::ranges::max_element(found_, {}, &Disc::radius)->radius;
  constexpr std::size_t kBuckets = 128;
  const float scale = (static_cast<float>(kBuckets) - 1.0F) / largest;
  const auto bucket_of = [scale](float radius) {
    return kBuckets - 1 - std::min(static_cast<std::size_t>(radius * scale), kBuckets - 1);
  };
  std::array<std::uint32_t, kBuckets + 1> end{};
  for (const Disc& disc : found_) ++end[bucket_of(disc.radius) + 1];
  std::partial_sum(end.begin(), end.end(), end.begin());
  keys_.resize(found_.size());
  for (std::size_t i = 0; i < found_.size(); ++i) {
    keys_[end[bucket_of(found_[i].radius)]++] =
        (static_cast<std::uint64_t>(~std::bit_cast<std::uint32_t>(found_[i].radius)) << 32U) | i;
  }
  auto begin = keys_.begin();
  for (std::size_t bucket = 0; bucket < kBuckets; ++bucket) {
    const auto bucket_end = keys_.begin() + static_cast<std::ptrdiff_t>(end[bucket]);
    if (!std::is_sorted(begin, bucket_end)) std::sort(begin, bucket_end);
    begin = bucket_end;
  }
  for (const std::uint64_t key : keys_) discs.add(found_[key & 0xffffffffU]);
}

}  // namespace penumbra
