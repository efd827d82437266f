// What of a thing faces a plane's light, and the heights at which it is shadowed: each
// receives as a plane of its own does.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <vector>

#include "render/model/model.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Slopes have a level this often, where that is not too many. What lies between two levels receives
// a mixture of theirs; what lies farther than this above the highest receives nothing.
inline constexpr double kLevelStep = 4e-3;  // [m]
// What lies so far above a level is as good as on it.
inline constexpr double kLevelWidth = 5e-4;  // [m]

// How often slopes have one at most.
struct LevelSpacing {
  double step = kLevelStep;  // [m]
  // Of what lies lower [m]: no less than `step`. All of the caster is over that, and its outlines
  // change slowly enough.
  double clear_below = -1.0, clear_step = kLevelStep;
};

class ReceivingSurface {
 public:
  ReceivingSurface() = default;
  // Of faces above the plane that are not upright, however they are wound.
  ReceivingSurface(const Model& model, const Placement& T_table_object, const PlaneFrame& plane);

  // In (u, v) of the plane [m]; empty where nothing receives.
  [[nodiscard]] const Eigen::AlignedBox2d& bounds() const { return bounds_; }
  // Of what lies over the rectangle: heights above the plane [m], ascending, from 0 to `top`. Those
  // of level faces to 0.5 mm, the lowest of what is as good as one height; where faces slope, as
  // `spacing` says. No more than `most` (> 1): of more they are spaced evenly.
  [[nodiscard]] std::vector<double> levels(const Eigen::AlignedBox2d& over, double top,
                                           std::size_t most,
                                           const LevelSpacing& spacing = {}) const;
  // The lowest height of what lies over the rectangle [m]; infinite where nothing does.
  [[nodiscard]] double lowest(const Eigen::AlignedBox2d& over) const;

 private:
  struct Face {
    float u_low, u_high, v_low, v_high, low, high;  // [m]
    bool level;
  };
  [[nodiscard]] static bool meets(const Face& face, const Eigen::AlignedBox2d& over);

  std::vector<Face> faces_;
  Eigen::AlignedBox2d bounds_;
};

}  // namespace penumbra
