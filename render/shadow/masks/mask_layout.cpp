#include "render/shadow/masks/mask_layout.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace penumbra {
namespace {

// A mask with up to this number of cells along each side is neither split nor clipped, so camera
// motion does not change it.
constexpr std::int64_t kMaxUncutSide = 1024;
constexpr double kMaxCells = 1 << 23;  // total over the masks of a plane: 8 MiB
// The visible region is rounded to multiples of this: small camera motion does not change it.
constexpr std::int64_t kCutCells = 256;

// Adds a border of lit cells.
CellBox with_border(const CellBox& box) {
  const Eigen::Vector<std::int64_t, 2> one(1, 1);
  return {box.min() - one, box.max() + one};
}

MaskCells cells_of(const CellBox& box, double cell) {
  return {cell, box.min().x(), box.min().y(), static_cast<int>(box.sizes().x()) + 1,
          static_cast<int>(box.sizes().y()) + 1};
}

Eigen::AlignedBox2d on_plane(const CellBox& box, double cell) {
  return {cell * box.min().cast<double>(),
          cell * (box.max().cast<double>() + Eigen::Vector2d::Ones())};
}

// Converts a box to cells of another size, rounded outwards.
CellBox in_cells_of(const CellBox& box, int from, int to) {
  if (from == to) return box;
  const Eigen::AlignedBox2d rectangle = on_plane(box, cell_size(from) / cell_size(to));
  return with_border({rectangle.min().array().floor().matrix().cast<std::int64_t>(),
                      rectangle.max().array().floor().matrix().cast<std::int64_t>()});
}

// Returns the cells of the visible region, rounded to multiples of kCutCells.
CellBox visible_cells(const Eigen::AlignedBox2d& region, double cell) {
  const double step = cell * kCutCells;
  const Eigen::Vector2d first = (region.min() / step).array().floor();
  const Eigen::Vector2d end = (region.max() / step).array().floor() + 1.0;
  return {(kCutCells * first).cast<std::int64_t>(),
          (kCutCells * end).cast<std::int64_t>() - Eigen::Vector<std::int64_t, 2>(1, 1)};
}

struct PartGroup {
  std::vector<std::size_t> parts;
  CellBox box;
};

// Groups parts whose boxes intersect, until no boxes of two groups intersect.
std::vector<PartGroup> meeting_groups(std::span<const CellBox> boxes) {
  std::vector<PartGroup> groups;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    if (boxes[i].isEmpty()) continue;
    PartGroup group{{i}, boxes[i]};
    for (std::size_t other = 0; other < groups.size();) {
      if (!groups[other].box.intersects(group.box)) {
        ++other;
        continue;
      }
      group.box.extend(groups[other].box);
      group.parts.insert(group.parts.end(), groups[other].parts.begin(), groups[other].parts.end());
      groups.erase(groups.begin() + static_cast<std::ptrdiff_t>(other));
      other = 0;  // the group grew: compare with all others again
    }
    std::ranges::sort(group.parts);
    groups.push_back(std::move(group));
  }
  return groups;
}

}  // namespace

double cell_size(int half_octave) {
  return std::exp2(0.5 * half_octave);
}

MaskLayout lay_out_masks(std::span<const CellBox> bounds, int half_octave, std::int64_t max_side,
                         const std::function<VisiblePart(const Eigen::AlignedBox2d&)>& visible) {
  MaskLayout layout;
  PartGroup all;
  for (std::size_t i = 0; i < bounds.size(); ++i) {
    if (bounds[i].isEmpty()) continue;
    all.parts.push_back(i);
    all.box.extend(bounds[i]);
  }
  if (all.parts.empty()) return layout;
  if (all.box.sizes().maxCoeff() < kMaxUncutSide) {
    layout.groups.push_back(
        {all.parts, cells_of(with_border(all.box), cell_size(half_octave)), false});
    return layout;
  }
  layout.of_view = true;
  std::vector<VisiblePart> visible_parts(bounds.size());
  int finest = std::numeric_limits<int>::max();
  for (const std::size_t i : all.parts) {
    visible_parts[i] = visible(on_plane(with_border(bounds[i]), cell_size(half_octave)));
    if (!visible_parts[i].box.isEmpty()) finest = std::min(finest, visible_parts[i].half_octave);
  }
  if (finest == std::numeric_limits<int>::max()) return layout;
  for (int size = finest;; ++size) {
    layout.groups.clear();
    std::vector<CellBox> boxes(bounds.size());
    for (const std::size_t i : all.parts) {
      if (visible_parts[i].box.isEmpty()) continue;
      boxes[i] = with_border(in_cells_of(bounds[i], half_octave, size));
    }
    double cells = 0.0;
    std::int64_t longest = 0;
    for (const PartGroup& group : meeting_groups(boxes)) {
      CellBox box = group.box;
      const bool cut = box.sizes().maxCoeff() >= kMaxUncutSide;
      if (cut) {
        Eigen::AlignedBox2d visible_region;
        for (const std::size_t i : group.parts) visible_region.extend(visible_parts[i].box);
        box = box.intersection(visible_cells(visible_region, cell_size(size)));
        if (box.isEmpty()) continue;
      }
      const Eigen::Vector2d sides = box.sizes().cast<double>() + Eigen::Vector2d::Ones();
      cells += sides.prod();
      longest = std::max(longest, box.sizes().maxCoeff() + 1);
      if (cells > kMaxCells || longest > max_side) break;
      layout.groups.push_back({group.parts, cells_of(box, cell_size(size)), cut});
    }
    if (cells <= kMaxCells && longest <= max_side) return layout;
  }
}

}  // namespace penumbra
