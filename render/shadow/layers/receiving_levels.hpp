// The faces of a receiver over a plane, and the heights (levels) at which its shadow masks are made
// (docs/rendering.md#shadows-on-receivers).
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <vector>

#include "render/model/model.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Spacing of the levels of sloped faces [m]. Between two levels, masks are interpolated; farther
// than this above the highest level, there is no shadow.
inline constexpr double kLevelStep = 4e-3;   // [m]
inline constexpr double kLevelWidth = 5e-4;  // heights up to this above a level belong to it [m]

// Maximum spacing of the levels of sloped faces [m].
struct LevelSpacing {
  double step = kLevelStep;        // at heights from `clear_below` on
  double clear_below = -1.0;       // height under the caster; its outlines change slowly below it
  double clear_step = kLevelStep;  // at heights below `clear_below`
};

class ReceivingSurface {
 public:
  ReceivingSurface() = default;
  // Collects the faces above the plane that are not vertical, of either orientation.
  ReceivingSurface(const Model& model, const Placement& T_table_object, const PlaneFrame& plane);

  // Returns the faces' bounds in (u, v) of the plane [m]; empty if no face receives.
  [[nodiscard]] const Eigen::AlignedBox2d& bounds() const { return bounds_; }
  // Returns the levels of the faces over the rectangle: heights above the plane [m], ascending, up
  // to `top`. Horizontal faces within kLevelWidth share the lowest height; sloped faces get levels
  // at `spacing`. If there are over `limit` (> 1) levels, returns `limit` evenly spaced levels.
  [[nodiscard]] std::vector<double> levels(const Eigen::AlignedBox2d& rectangle, double top,
                                           std::size_t limit,
                                           const LevelSpacing& spacing = {}) const;
  // Returns the lowest height of the faces over the rectangle [m]; infinity if there are none.
  [[nodiscard]] double lowest(const Eigen::AlignedBox2d& rectangle) const;

 private:
  struct Face {
    float u_low, u_high, v_low, v_high, low, high;  // [m]
    bool level;
  };
  [[nodiscard]] static bool overlaps(const Face& face, const Eigen::AlignedBox2d& rectangle);

  std::vector<Face> faces_;
  Eigen::AlignedBox2d bounds_;
};

}  // namespace penumbra
