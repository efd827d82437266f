// Reads and writes files; parses, escapes and compares text.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// Reads the whole file and drops a UTF-8 byte-order mark. Waits for the writer of a named pipe.
// Fails if the file is missing, a folder, unreadable, larger than `max_bytes`, or encoded in UTF-16
// or UTF-32.
[[nodiscard]] Result<std::string> read_text_file(const std::filesystem::path& file,
                                                 std::size_t max_bytes);
// Sets the function that read_text_file() calls after it has waited for a writer for 1 s. Call
// before other threads start.
void set_wait_notice(void (*notice)(const std::string& line));
[[nodiscard]] Result<void> write_text_file(const std::filesystem::path& file,
                                           std::string_view text);

[[nodiscard]] std::string system_message(int error);  // message for an errno value

[[nodiscard]] std::string_view trim(std::string_view text);  // blanks, tabs, line ends
[[nodiscard]] std::vector<std::string_view> split(std::string_view text, char separator);
[[nodiscard]] std::string in_lower_case(std::string text);                     // ASCII letters
[[nodiscard]] std::string lower_extension(const std::filesystem::path& file);  // ".png"

// Parses the whole `text` in the C locale, or returns nullopt. Accepts "nan" and "inf".
[[nodiscard]] std::optional<double> parse_number(std::string_view text);
[[nodiscard]] std::optional<std::int64_t> parse_integer(std::string_view text);

// Parses decimal seconds ("1311868164.363181", "1.4e9"), rounded to the nearest nanosecond without
// a detour through double. Returns nullopt for other text, or beyond +-4e9 s.
[[nodiscard]] std::optional<std::int64_t> parse_seconds_as_ns(std::string_view text);
// Formats seconds with 9 decimals.
[[nodiscard]] std::string format_ns_as_seconds(std::int64_t nanoseconds);
// Formats nanoseconds since 1970 as ISO 8601: "2026-11-28T04:29:37.000000000Z".
[[nodiscard]] std::string format_utc(std::int64_t nanoseconds);

// Returns "1, 2.5, 3"; `format` applies to each value. Replaces fmt::join, which compiles the
// formatting of numbers into each file that uses it.
[[nodiscard]] std::string joined(std::span<const double> values, std::string_view format = "{}");
[[nodiscard]] std::string joined(std::span<const int> values);

// Returns at most `max_bytes` from the beginning of a text, in whole UTF-8 characters.
[[nodiscard]] std::string_view first_characters(std::string_view text, std::size_t max_bytes);
// Returns the beginning of a long text and "...", or a short text unchanged, for messages.
[[nodiscard]] std::string shortened(std::string_view text, std::size_t max_bytes = 60);

// Escapes text for HTML and SVG elements and attributes.
[[nodiscard]] std::string in_markup(std::string_view text);
// Returns a double-quoted YAML string.
[[nodiscard]] std::string in_quotes(std::string_view text);

// Edit distance in bytes (Levenshtein 1966).
[[nodiscard]] std::size_t edit_distance(std::string_view a, std::string_view b);

// Returns `text` without a leading UTF-8 byte-order mark. Windows editors write one.
// Fails for UTF-16 and UTF-32, found by their byte-order marks or by a zero byte beside the first
// character. `name` is the file's name in the error.
[[nodiscard]] Result<std::string_view> without_byte_order_mark(std::string_view text,
                                                               std::string_view name);

// Returns valid UTF-8 for JSON, SVG and HTML: interprets a byte outside any valid sequence as
// Latin-1.
[[nodiscard]] std::string as_utf8(std::string_view text);

// Returns as_utf8() on one line: a blank replaces each line break and other control character.
[[nodiscard]] std::string as_printable_line(std::string_view text);

inline constexpr std::size_t kMaxFileBytes = std::size_t{1} << 30U;

// Returns the bytes of a regular file. Fails if it is missing, not regular, unreadable or larger
// than `max_bytes`.
[[nodiscard]] Result<std::vector<std::uint8_t>> read_file(const std::filesystem::path& file,
                                                          std::size_t max_bytes = kMaxFileBytes);
// Replaces the file. Fails if the disk fills up.
[[nodiscard]] Result<void> write_file(const std::filesystem::path& file,
                                      std::span<const std::uint8_t> bytes);

}  // namespace penumbra
