// How alike two words are, to say which one was meant.
#pragma once

#include <cstddef>
#include <string_view>

namespace penumbra {

// How many letters have to be put in, taken out or replaced to make one of the other (Levenshtein
// 1966), of bytes. 0: they are the same.
[[nodiscard]] std::size_t letters_apart(std::string_view a, std::string_view b);

}  // namespace penumbra
