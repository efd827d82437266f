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

// The bytes of a regular file. Fails when it is missing, no regular file, unreadable or over
// `max_bytes`.
[[nodiscard]] Result<std::vector<std::uint8_t>> read_file(const std::filesystem::path& file,
                                                          std::size_t max_bytes = kMaxFileBytes);
// Replaces the file. A disk that fills up is an error, never a silently short file.
[[nodiscard]] Result<void> write_file(const std::filesystem::path& file,
                                      std::span<const std::uint8_t> bytes);

}  // namespace penumbra
