// Whole files in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

inline constexpr std::size_t kMaxFileBytes = std::size_t{1} << 30U;

// Returns the bytes of a regular file. Fails if it is missing, not regular, unreadable or larger
// than `max_bytes`.
[[nodiscard]] Result<std::vector<std::uint8_t>> read_file(const std::filesystem::path& file,
                                                          std::size_t max_bytes = kMaxFileBytes);
// Replaces the file. Fails if the disk fills up.
[[nodiscard]] Result<void> write_file(const std::filesystem::path& file,
                                      std::span<const std::uint8_t> bytes);

}  // namespace penumbra
