// The constants of layered penumbrae (docs/shadows.md#constants): height and size of the light, and
// the range of heights that each layer projects.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/error.hpp"

namespace penumbra {

enum class ShadowLayer { umbra, middle, penumbra };
inline constexpr std::array kShadowLayers = {ShadowLayer::umbra, ShadowLayer::middle,
                                             ShadowLayer::penumbra};
[[nodiscard]] constexpr int lambda_of(ShadowLayer layer) {
  return layer == ShadowLayer::umbra ? -1 : layer == ShadowLayer::middle ? 0 : 1;
}

// H > 0: light height above the plane, may be +infinity. a > 0: light radius / object radius.
struct LayeredConstants {
  double light_height = 0.9;       // H [m]
  double light_ratio = 3.0;        // a
  double umbra_height = 0.3;       // h_u = H / a [m]; for a > 1 the umbra vanishes at it
  double magnification_cap = 8.0;  // m; faces are clipped at h = H (1 - 1/m)
  friend bool operator==(const LayeredConstants&, const LayeredConstants&) = default;
};

[[nodiscard]] inline bool umbra_vanishes(const LayeredConstants& constants) {
  return constants.light_ratio > 1.0 || std::isinf(constants.light_height);
}

// Returns checked constants. light_ratio or umbra_height may be 0 and is then computed from h_u = H
// / a. H may be +inf if umbra_height is given. The other values must be positive and finite.
// With a <= 1 the umbra never vanishes.
[[nodiscard]] Result<LayeredConstants> make_layered_constants(double light_height,
                                                              double light_ratio,
                                                              double umbra_height);
// Computes the constants from the maximum height of objects (h_max) and the magnification M > 1 of
// the middle layer at that height: a = M / (M - 1), H = a h_max, so that h_u = h_max
// (docs/shadows.md#constants).
[[nodiscard]] Result<LayeredConstants> layered_constants_for_workspace(double max_height,
                                                                       double magnification);

// Heights above the plane [m] to which a layer clips faces. low = 0; high = H (1 - 1/m); for an
// umbra that vanishes, at most h_u.
struct HeightRange {
  double low = 0.0;
  double high = 0.0;
};
[[nodiscard]] inline HeightRange layer_height_range(const LayeredConstants& constants,
                                                    ShadowLayer layer) {
  HeightRange range;
  range.high = std::isinf(constants.light_height)
                   ? std::numeric_limits<double>::infinity()
                   : constants.light_height * (1.0 - 1.0 / constants.magnification_cap);
  if (layer == ShadowLayer::umbra && umbra_vanishes(constants)) {
    range.high = std::min(range.high, constants.umbra_height);
  }
  return range;
}

}  // namespace penumbra
