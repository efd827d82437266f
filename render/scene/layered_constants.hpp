// The constants of layered penumbrae (docs/shadows.md#constants): the light's height and size, and
// the heights in which each layer has matter to project.
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

// H > 0: light height above the plane, may be +infinity (then umbra_height says where the umbra
// vanishes); a > 0: light radius over object radius.
struct LayeredConstants {
  double light_height = 0.9;       // H [m]
  double light_ratio = 3.0;        // a
  double umbra_height = 0.3;       // h_u = H / a [m]
  double magnification_cap = 8.0;  // faces are clipped at h = H (1 - 1/m)
  friend bool operator==(const LayeredConstants&, const LayeredConstants&) = default;
};

// True if the umbra ends at h_u.
[[nodiscard]] inline bool umbra_vanishes(const LayeredConstants& constants) {
  return constants.light_ratio > 1.0 || std::isinf(constants.light_height);
}

// Checked constants. Exactly one of light_ratio, umbra_height may be left at 0: it follows from H /
// a = h_u. H may be +inf with umbra_height. Fails on non-finite or non-positive values; a <= 1 is
// legal (the umbra never vanishes).
[[nodiscard]] Result<LayeredConstants> make_layered_constants(double light_height,
                                                              double light_ratio,
                                                              double umbra_height);
// From the highest point an object can take (h_max) and the wanted magnification M > 1 of the
// middle layer there: a = M / (M - 1), H = a h_max (docs/shadows.md#constants).
[[nodiscard]] Result<LayeredConstants> layered_constants_for_workspace(double max_height,
                                                                       double magnification);

// Heights [low, high] above the plane [m] in which a layer has matter to project: faces are clipped
// to it. low = 0. high = h_u for the umbra where a > 1, and never above the cap H (1 - 1/m).
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
