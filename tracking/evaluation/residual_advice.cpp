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
    case ErrorCause::paper:
      return fmt::format("the tags are about {:.1g} mm from where the map has them: penumbra map",
                         1e3 * std::hypot(sizes.off_flat_m, sizes.in_plane_m));
    case ErrorCause::lens:
      return lens_difference(sizes) +
             " the camera file: penumbra calibrate, or penumbra map --refine-camera";
    case ErrorCause::shutter:
      return fmt::format(
          "the rows seem to be exposed {:.1f} us after each other: rolling_shutter_row_s: {:.3g} "
          "in the camera file",
          1e6 * (given_row_s + sizes.row_time_s), given_row_s + sizes.row_time_s);
  }
  return {};
}

}  // namespace penumbra
