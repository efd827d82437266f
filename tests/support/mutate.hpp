// Seeded damage to bytes, for fuzz tests: the same inputs in every run and on every machine.
#pragma once

#include <algorithm>
#include <array>
#include <string>
#include <string_view>

#include "core/random.hpp"

namespace penumbra::test {

using Random = SplitMix64;

// Applies one to four mutations, usually one: flipped bits, special byte values, truncation, and
// pieces removed, doubled, moved or zeroed. `words` are tokens that a text parser may handle badly;
// they are inserted as a whole.
inline std::string mutated(std::string bytes, Random& random,
                           std::initializer_list<std::string_view> words = {}) {
  constexpr std::array<unsigned char, 8> kEdgeValues{0x00, 0xFF, 0x7F, 0x80,
                                                     0x01, 0xFE, 0x20, 0x0A};
  const std::size_t mutations = 1 + random.below(1 + random.below(4));
  for (std::size_t i = 0; i < mutations; ++i) {
    if (bytes.empty()) bytes.push_back(static_cast<char>(random.below(256)));
    const std::size_t at = random.below(bytes.size());
    const std::size_t length = 1 + random.below(std::min<std::size_t>(64, bytes.size() - at));
    switch (random.below(words.size() == 0 ? 8 : 12)) {
      case 0:
      case 1:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random.below(8)));
        break;
      case 2:
        bytes[at] = static_cast<char>(kEdgeValues[random.below(kEdgeValues.size())]);
        break;
      case 3:
        for (std::size_t k = 0; k < std::min<std::size_t>(4, bytes.size() - at); ++k) {
          bytes[at + k] = static_cast<char>(random.below(256));
        }
        break;
      case 4:
        bytes.erase(at, length);
        break;
      case 5:
        bytes.insert(random.below(bytes.size()), bytes.substr(at, length));
        break;
      case 6:
        std::fill_n(bytes.begin() + static_cast<std::ptrdiff_t>(at), length, '\0');
        break;
      case 7:
        bytes.resize(at);
        break;
      default: {
        const std::string_view word = words.begin()[random.below(words.size())];
        // Replaces a number or a word if there is one.
        const std::size_t first = bytes.find_first_of("-0123456789abcdefghijklmnopqrstuvwxyz", at);
        if (first == std::string::npos) {
          bytes.insert(at, word);
        } else {
          const std::size_t last = bytes.find_first_of(" ,:[]{}\n\r\t", first);
          bytes.replace(first, (last == std::string::npos ? bytes.size() : last) - first, word);
        }
        break;
      }
    }
  }
  return bytes;
}

}  // namespace penumbra::test
