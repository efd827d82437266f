// Computes the position of the sun, for studies of daylight.
#pragma once

#include <Eigen/Core>

namespace penumbra {

struct SunPosition {
  double azimuth_rad = 0.0;    // from north, clockwise seen from above: east is pi / 2
  double elevation_rad = 0.0;  // above the horizon; without refraction
};

// Uses the low-precision formulas of the Astronomical Almanac in the form of J. J. Michalsky, "The
// Astronomical Almanac's algorithm for approximate solar position (1950-2050)", Solar Energy 40
// (1988) 227-235: accurate to 0.01 degrees in those years. `utc_s`: seconds since 1970-01-01 00:00
// UTC; north and east are > 0.
[[nodiscard]] SunPosition sun_position(double utc_s, double latitude_deg, double longitude_deg);

// Returns the unit vector to the sun, table frame; north is +y rotated anticlockwise by north_deg.
[[nodiscard]] Eigen::Vector3d direction_to(const SunPosition& sun, double north_deg);

}  // namespace penumbra
