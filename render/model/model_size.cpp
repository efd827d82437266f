#include "render/model/model_size.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/vec3.hpp>

namespace penumbra {
namespace {

// Returns the first unit in which a length of `count` units is between `low` and `high` [m].
const LengthUnit* unit_between(double count, double low, double high) {
  const auto unit = std::ranges::find_if(kLengthUnits, [&](const LengthUnit& candidate) {
    return count * candidate.length_m >= low && count * candidate.length_m <= high;
  });
  return unit == kLengthUnits.end() ? nullptr : &*unit;
}

const LengthUnit* likely_unit(double count) {
  const LengthUnit* common = unit_between(count, 0.02, 2.0);
  return common ? common : unit_between(count, kSmallestOnTable, kLargestOnTable);
}

}  // namespace

std::string size_text(double length_m) {
  return length_m < 0.01 ? fmt::format("{:.3g} mm", 1e3 * length_m)
                         : fmt::format("{:.3g} m", length_m);
}

std::optional<std::string> warning_of_size(const Model& model, const ModelSize& size,
                                           const std::string& subject) {
  const glm::dvec3 extent = glm::dvec3(model.max_corner) - glm::dvec3(model.min_corner);
  const double longest = std::max({extent.x, extent.y, extent.z});
  const double length = longest * size.scale;
  if (!std::isfinite(length) || !(length > 0.0)) return std::nullopt;
  if (length <= kLargestOnTable && length >= kSmallestOnTable) return std::nullopt;
  const std::string start = fmt::format("{}: is {} {}", subject, size_text(length),
                                        extent.z == longest ? "high" : "wide");
  const bool scene = size.remedy == SizeRemedy::scene_scale;
  // A scene's scale may already convert the unit, so the unit is guessed from the unscaled length.
  const LengthUnit* unit = likely_unit(scene ? longest : longest / size.unit_m);
  if (unit == nullptr) {
    const double factor = std::pow(10.0, std::round(std::log10(0.1 / length)));
    return scene ? fmt::format("{}; use scale {:.3g}", start, factor * size.scale)
                 : fmt::format("{}; export it {:g} times {}", start, std::max(factor, 1.0 / factor),
                               factor > 1.0 ? "larger" : "smaller");
  }
  return scene ? fmt::format("{}; in {}? use scale {:g}", start, unit->plural, unit->length_m)
               : fmt::format("{}; in {}? use --unit {}", start, unit->plural, unit->symbol);
}

}  // namespace penumbra
