// Iterates over the set flags of a sparse array.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <span>

namespace penumbra {

// Calls use(index) for each flag that is 1, in order. All other flags must be 0, and the number of
// flags a multiple of 8.
template <class Use>
void for_each_set(std::span<const std::uint8_t> flags, const Use& use) {
  for (std::size_t block = 0; block < flags.size(); block += sizeof(std::uint64_t)) {
    std::uint64_t eight = 0;
    std::memcpy(&eight, flags.data() + block, sizeof(eight));
    for (; eight != 0; eight &= eight - 1)
      use(block + static_cast<std::size_t>(std::countr_zero(eight)) / 8);
  }
}

}  // namespace penumbra
