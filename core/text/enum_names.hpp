// Tables of the names of an enum's values: arrays of EnumName, for options, files and reports.
#pragma once

#include <array>
#include <optional>
#include <string_view>

namespace penumbra {

template <class Enum>
struct EnumName {
  Enum value;
  std::string_view name;
};

// Returns an empty name for a value that the table lacks.
[[nodiscard]] constexpr std::string_view name_of(const auto& table, auto value) {
  for (const auto& entry : table)
    if (entry.value == value) return entry.name;
  return {};
}
// Returns nullopt for an unknown name.
[[nodiscard]] constexpr auto value_named(const auto& table, std::string_view name) {
  for (const auto& entry : table)
    if (entry.name == name) return std::optional(entry.value);
  return decltype(std::optional(table[0].value))();
}

}  // namespace penumbra
