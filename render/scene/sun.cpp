#include "render/scene/sun.hpp"

#include <cmath>
#include <numbers>

namespace penumbra {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kJ2000_s = 946728000.0;  // 2000-01-01 12:00 UTC
constexpr double kDay_s = 86400.0;

}  // namespace

SunPosition sun_position(double utc_s, double latitude_deg, double longitude_deg) {
  const double days = (utc_s - kJ2000_s) / kDay_s;
  // Ecliptic coordinates [degrees].
  const double mean_longitude = 280.460 + 0.9856474 * days;
  const double anomaly = (357.528 + 0.9856003 * days) * kDegree;
  const double longitude =
      (mean_longitude + 1.915 * std::sin(anomaly) + 0.020 * std::sin(2.0 * anomaly)) * kDegree;
  const double obliquity = (23.439 - 0.0000004 * days) * kDegree;
  const double right_ascension =
      std::atan2(std::cos(obliquity) * std::sin(longitude), std::cos(longitude));
  const double declination = std::asin(std::sin(obliquity) * std::sin(longitude));
  // Sidereal time [hours]: the almanac's 0.0657098242 h per day, plus 1 h per hour.
  const double sidereal = std::fmod(6.697375 + 12.0 + 24.0657098242 * days, 24.0);
  const double hour_angle = (sidereal * 15.0 + longitude_deg) * kDegree - right_ascension;
  const double latitude = latitude_deg * kDegree;
  SunPosition sun;
  sun.elevation_rad = std::asin(std::sin(declination) * std::sin(latitude) +
                                std::cos(declination) * std::cos(latitude) * std::cos(hour_angle));
  const double east = -std::cos(declination) * std::sin(hour_angle);
  const double north = std::sin(declination) * std::cos(latitude) -
                       std::cos(declination) * std::sin(latitude) * std::cos(hour_angle);
  sun.azimuth_rad = std::atan2(east, north);
  if (sun.azimuth_rad < 0.0) sun.azimuth_rad += 2.0 * std::numbers::pi;
  return sun;
}

Eigen::Vector3d direction_to(const SunPosition& sun, double north_deg) {
  const double level = std::cos(sun.elevation_rad);
  const double turn = north_deg * kDegree - sun.azimuth_rad;  // counter-clockwise from +y
  return {-level * std::sin(turn), level * std::cos(turn), std::sin(sun.elevation_rad)};
}

}  // namespace penumbra
