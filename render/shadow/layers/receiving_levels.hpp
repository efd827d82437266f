// The faces of a receiver that face a plane's light, and the heights at which it is shadowed
// (docs/rendering.md#shadows-on-receivers).
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <vector>

#include "render/model/model.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Distance of the levels of slopes. Heights between two levels receive a mixture of theirs; heights
// farther than this above the highest level receive nothing.
inline constexpr double kLevelStep = 4e-3;   // [m]
inline constexpr double kLevelWidth = 5e-4;  // heights this far above a level count as on it [m]

// Least distances of the levels of slopes.
struct LevelSpacing {
  double step = kLevelStep;  // [m]
  // Below `clear_below`, where all of the caster is higher and its outlines change slowly [m].
  double clear_below = -1.0, clear_step = kLevelStep;
};

class ReceivingSurface {
 public:
  ReceivingSurface() = default;
  // Takes the faces above the plane that are not upright, of either orientation.
  ReceivingSurface(const Model& model, const Placement& T_table_object, const PlaneFrame& plane);

  // In (u, v) of the plane [m]; empty where nothing receives.
  [[nodiscard]] const Eigen::AlignedBox2d& bounds() const { return bounds_; }
  // Levels of the faces over the rectangle: heights above the plane [m], ascending, up to `top`.
  // Level faces within kLevelWidth share the lowest height; slopes are spaced by `spacing`. More
  // than `most` (> 1) levels are replaced by `most` evenly spaced ones.
  [[nodiscard]] std::vector<double> levels(const Eigen::AlignedBox2d& over, double top,
                                           std::size_t most,
                                           const LevelSpacing& spacing = {}) const;
  // The lowest height of the faces over the rectangle [m]; infinite without any.
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
