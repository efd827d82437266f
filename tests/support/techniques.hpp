// Lists of shadow techniques for tests, taken from the program's table.
#pragma once

#include <algorithm>
#include <initializer_list>
#include <string>
#include <vector>

#include "render/scene/technique.hpp"

namespace penumbra::test {

// Returns all techniques except those given.
inline std::vector<ShadowTechnique> techniques_without(
    std::initializer_list<ShadowTechnique> excluded) {
  std::vector<ShadowTechnique> techniques;
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    if (std::ranges::find(excluded, technique) == excluded.end()) techniques.push_back(technique);
  }
  return techniques;
}

// Returns the values of --shadow except those given; always includes "cocl".
inline std::vector<std::string> shadow_words_without(
    std::initializer_list<ShadowTechnique> excluded) {
  std::vector<std::string> words = {"cocl"};
  for (const ShadowTechnique technique : techniques_without(excluded))
    words.emplace_back(to_string(technique));
  return words;
}

}  // namespace penumbra::test
