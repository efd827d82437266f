// Units of length, and warnings about models whose size suggests another unit.
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

// Range of plausible sizes on a table [m].
inline constexpr double kLargestOnTable = 5.0;
inline constexpr double kSmallestOnTable = 0.002;

// How the warning advises to change a model's size.
enum class SizeRemedy { unit_option, scene_scale };

struct ModelSize {
  double scale = 1.0;   // in the scene
  double unit_m = 1.0;  // as given to load_model()
  SizeRemedy remedy = SizeRemedy::unit_option;
};

// Returns a length in mm below 1 cm, else in m: "3.2 mm", "0.4 m".
[[nodiscard]] std::string size_text(double length_m);

// Returns a warning, beginning with `subject`, if the model is larger than kLargestOnTable or
// smaller than kSmallestOnTable: its size, the likely unit and the remedy. Returns nullopt for a
// model without extent.
[[nodiscard]] std::optional<std::string> warning_of_size(const Model& model, const ModelSize& size,
                                                         const std::string& subject);

}  // namespace penumbra
