// Text files and the numbers in them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Reads the whole file, without a UTF-8 byte-order mark; waits for the writer of a named pipe.
// Fails if the file is missing, a folder, not readable, larger than `max_bytes`, or UTF-16 or
// UTF-32 text.
[[nodiscard]] Result<std::string> read_text_file(const std::filesystem::path& file,
                                                 std::size_t max_bytes);
// Sets the function that gets a line once read_text_file() has waited for a writer for a second.
// To be called before other threads start.
void set_wait_notice(void (*notice)(const std::string& line));
[[nodiscard]] Result<void> write_text_file(const std::filesystem::path& file,
                                           std::string_view text);

[[nodiscard]] std::string_view trim(std::string_view text);  // blanks, tabs, line ends

// The whole of `text` as a number, in the C locale; nothing if it holds anything else. "nan" and
// "inf" are numbers here.
[[nodiscard]] std::optional<double> parse_number(std::string_view text);
[[nodiscard]] std::optional<std::int64_t> parse_integer(std::string_view text);

// Decimal seconds ("1311868164.363181", "1.4e9") as nanoseconds, exact up to the nanosecond and
// rounded to nearest beyond. Nothing for anything else, or beyond +-4e9 s.
[[nodiscard]] std::optional<std::int64_t> parse_seconds_as_ns(std::string_view text);
// Seconds with 9 decimals.
[[nodiscard]] std::string format_ns_as_seconds(std::int64_t nanoseconds);

// "1, 2.5, 3": each value in this format of fmt's. fmt::join would compile the formatting of
// numbers into each file that uses it.
[[nodiscard]] std::string joined(std::span<const double> values, std::string_view format = "{}");
[[nodiscard]] std::string joined(std::span<const int> values);

// As text or an attribute's value in HTML and SVG.
[[nodiscard]] std::string in_markup(std::string_view text);
// As a double-quoted YAML string.
[[nodiscard]] std::string in_quotes(std::string_view text);

}  // namespace penumbra
