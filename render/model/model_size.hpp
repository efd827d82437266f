// Units of length, and models whose size suggests that their file has another unit.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>

#include "render/model/model.hpp"

namespace penumbra {

struct LengthUnit {
  std::string_view symbol;
  std::string_view plural;
  double length_m;
};
inline constexpr std::array kLengthUnits = {
    LengthUnit{"mm", "millimetres", 0.001},
    LengthUnit{"cm", "centimetres", 0.01},
    LengthUnit{"m", "metres", 1.0},
    LengthUnit{"in", "inches", 0.0254},
};

[[nodiscard]] constexpr const LengthUnit* length_unit_from_string(std::string_view symbol) {
  for (const LengthUnit& unit : kLengthUnits) {
    if (unit.symbol == symbol) return &unit;
  }
  return nullptr;
}

// Models of other sizes are not expected on a table [m].
inline constexpr double kLargestOnTable = 5.0;
inline constexpr double kSmallestOnTable = 0.002;

// How a user gives a model another size.
enum class SizeRemedy { unit_option, scene_scale };

struct ModelSize {
  double scale = 1.0;   // that the model has in its scene
  double unit_m = 1.0;  // that it was read with
  SizeRemedy remedy = SizeRemedy::unit_option;
};

// A line for the user where a model is larger than 5 m or smaller than 2 mm: its size, the unit
// that its file is likely in, and what to give. `subject`: what the line is about. Nothing for a
// model without an extent.
[[nodiscard]] std::optional<std::string> warning_of_size(const Model& model, const ModelSize& size,
                                                         const std::string& subject);

}  // namespace penumbra
