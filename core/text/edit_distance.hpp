// Edit distance of words, to suggest the one that a misspelt word means.
#pragma once

#include <cstddef>
#include <string_view>

namespace penumbra {

// Edit distance in bytes (Levenshtein 1966).
[[nodiscard]] std::size_t edit_distance(std::string_view a, std::string_view b);

}  // namespace penumbra
