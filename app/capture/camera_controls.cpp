#include "app/capture/camera_controls.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace penumbra {

std::string changed_control_text(std::string_view name, std::string_view unit, double requested,
                                 double given, const std::optional<ControlRange>& range) {
  std::string text =
      fmt::format("{}: the camera gives {:.6g}{} for {:.6g}{}", name, given, unit, requested, unit);
  if (!range) return text;
  return text + fmt::format("; it takes {:.6g} to {:.6g}{}", range->lowest, range->highest, unit);
}

GrantedControl granted_control(std::string_view name, std::string_view unit, double requested,
                               const ControlRange& range) {
  const bool known = std::isfinite(range.lowest) && std::isfinite(range.highest) &&
                     range.lowest <= range.highest && (range.lowest != 0.0 || range.highest != 0.0);
  if (!known || (requested >= range.lowest && requested <= range.highest)) return {requested, {}};
  const double value = std::clamp(requested, range.lowest, range.highest);
  return {value, changed_control_text(name, unit, requested, value, range)};
}

}  // namespace penumbra
