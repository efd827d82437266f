// Suggests the word that was meant by a misspelt one.
#pragma once

#include <cstddef>
#include <string_view>

namespace penumbra {

// Edit distance in bytes (Levenshtein 1966).
[[nodiscard]] std::size_t letters_apart(std::string_view a, std::string_view b);

}  // namespace penumbra
