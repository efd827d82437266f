// What of a real thing faces a plane's light, and the heights at which it is shadowed: each
// receives as a plane of its own does.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <vector>

#include "render/model.hpp"
#include "render/scene.hpp"
#include "render/shadow/plane_frame.hpp"

namespace penumbra {

class ReceivingSurface {
 public:
  ReceivingSurface() = default;
  // Of faces above the plane that are not upright, however they are wound.
  ReceivingSurface(const Model& model, const Placement& T_table_object, const PlaneFrame& plane);

  // In (u, v) of the plane [m]; empty where nothing receives.
  [[nodiscard]] const Eigen::AlignedBox2d& bounds() const { return bounds_; }
  // Of what lies over the rectangle: heights above the plane [m], ascending, from 0 to `top`. Those
  // of level faces to 0.5 mm, the lowest of what is as good as one height; where faces slope, one
  // every few millimetres. No more than `most` (> 1): of more they are spaced evenly.
  [[nodiscard]] std::vector<double> levels(const Eigen::AlignedBox2d& over, double top,
                                           std::size_t most) const;

 private:
  struct Face {
    float u_low, u_high, v_low, v_high, low, high;  // [m]
    bool level;
  };
  std::vector<Face> faces_;
  Eigen::AlignedBox2d bounds_;
};

// Slopes have a level this often, where that is not too many. What lies between two levels receives
// as at the nearer one; what lies farther than this above the highest receives nothing.
inline constexpr double kLevelStep = 4e-3;  // [m]

}  // namespace penumbra
