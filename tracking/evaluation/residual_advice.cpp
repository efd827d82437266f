#include <fmt/format.h>

#include <cmath>

#include "tracking/evaluation/residual_causes.hpp"

namespace penumbra {
namespace {

// Names the focal length only if its difference is significant.
std::string lens_difference(const CauseSizes& sizes) {
  constexpr double kMinFocalFraction = 5e-4;
  const double focal = std::abs(sizes.focal_fraction);
  if (focal < kMinFocalFraction || focal < 2.0 * sizes.focal_sigma)
    return "the distortion or the principal point seems to differ from";
  return fmt::format("the focal length seems {:.1f} % {} than in", 100.0 * focal,
                     sizes.focal_fraction > 0.0 ? "larger" : "smaller");
}

}  // namespace

std::string advice(ErrorCause cause, const CauseSizes& sizes, double given_row_s) {
  switch (cause) {
    case ErrorCause::paper: {
      const double displaced_mm = 1e3 * std::hypot(sizes.off_flat_m, sizes.in_plane_m);
      return fmt::format(
          "the tags are displaced by about {} mm from the map: --refine-map of replay or live, or "
          "penumbra map",
          displaced_mm < 9.5 ? fmt::format("{:.1g}", displaced_mm)
                             : fmt::format("{:.0f}", displaced_mm));
    }
    case ErrorCause::lens:
      return lens_difference(sizes) +
             " the camera file: penumbra calibrate, or --refine-map with --refine-camera of replay "
             "or live, or penumbra map --refine-camera";
    case ErrorCause::shutter: {
      const double row_s = given_row_s + sizes.row_time_s;
      if (!(row_s > 0.0)) {
        return "the rows seem to be exposed from the bottom up, which can't be corrected; turn the "
               "camera upright";
      }
      return fmt::format(
          "the row time seems to be {:.1f} us: --refine-map of replay or live, or penumbra map "
          "--refine-camera, or set rolling_shutter_row_s: {:.3g} in the camera file",
          1e6 * row_s, row_s);
    }
  }
  return {};
}

}  // namespace penumbra
