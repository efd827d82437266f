#include "app/capture/camera_controls.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace penumbra {

GrantedControl granted_control(std::string_view name, std::string_view unit, double requested,
                               const ControlRange& range) {
  const bool known = std::isfinite(range.lowest) && std::isfinite(range.highest) &&
                     range.lowest <= range.highest && (range.lowest != 0.0 || range.highest != 0.0);
  if (!known || (requested >= range.lowest && requested <= range.highest)) return {requested, {}};
  const double value = std::clamp(requested, range.lowest, range.highest);
  return {value,
          fmt::format("{}: the camera gives {:.6g}{} for {:.6g}{}; it takes {:.6g} to {:.6g}{}",
                      name, value, unit, requested, unit, range.lowest, range.highest, unit)};
}

}  // namespace penumbra
