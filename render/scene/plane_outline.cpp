#include "render/scene/plane_outline.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace penumbra {
namespace {

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

}  // namespace

bool is_inside(const Eigen::Vector2d& p, std::span<const Eigen::Vector2d> outline) {
  bool in = false;
  for (std::size_t i = 0; i < outline.size(); ++i) {
    const Eigen::Vector2d& a = outline[i];
    const Eigen::Vector2d& b = outline[(i + 1) % outline.size()];
    if ((a.y() > p.y()) == (b.y() > p.y())) continue;
    if (p.x() < a.x() + (b.x() - a.x()) * (p.y() - a.y()) / (b.y() - a.y())) in = !in;
  }
  return in;
}

std::vector<PlaneLine> parts_inside(const PlaneLine& line,
                                    std::span<const Eigen::Vector2d> outline) {
  const Eigen::Vector2d along = line.to - line.from;
  std::vector<double> cuts = {0.0, 1.0};  // positions on the line where it may enter or leave
  for (std::size_t i = 0; i < outline.size(); ++i) {
    const Eigen::Vector2d a = outline[i] - line.from;
    const Eigen::Vector2d b = outline[(i + 1) % outline.size()] - line.from;
    // The sides at a corner agree on where it lies, so a line through the corner crosses one.
    if ((cross(along, a) > 0.0) == (cross(along, b) > 0.0)) continue;
    const double t = cross(a, b - a) / cross(along, b - a);
    if (t > 0.0 && t < 1.0) cuts.push_back(t);
  }
  std::ranges::sort(cuts);
  const auto at = [&](double t) -> Eigen::Vector2d {
    return t == 1.0 ? line.to : Eigen::Vector2d(line.from + t * along);
  };
  std::vector<PlaneLine> parts;
  double end = -1.0;  // of the latest part
  for (std::size_t i = 0; i + 1 < cuts.size(); ++i) {
    if (cuts[i] == cuts[i + 1] || !is_inside(at(0.5 * (cuts[i] + cuts[i + 1])), outline)) continue;
    if (end == cuts[i]) {
      parts.back().to = at(cuts[i + 1]);
    } else {
      parts.push_back({at(cuts[i]), at(cuts[i + 1])});
    }
    end = cuts[i + 1];
  }
  return parts;
}

}  // namespace penumbra
