// Tests positions and lines against the outline of a plane: a simple polygon in (u, v) [m]. The
// polygon may be concave, and in either order.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

namespace penumbra {

// Returns true if p is inside, by the even-odd rule. An empty outline contains nothing.
[[nodiscard]] bool is_inside(const Eigen::Vector2d& p, std::span<const Eigen::Vector2d> outline);

struct PlaneLine {
  Eigen::Vector2d from, to;
};
// Returns the parts of a finite line that are inside, in the line's order and direction. The ends
// of the line are kept exactly.
[[nodiscard]] std::vector<PlaneLine> parts_inside(const PlaneLine& line,
                                                  std::span<const Eigen::Vector2d> outline);

}  // namespace penumbra
