// Byte-order marks at the head of text files, and text that is not UTF-8.
#pragma once

#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Returns `text` without a leading UTF-8 byte-order mark. Windows editors write one.
// Fails for UTF-16 and UTF-32, which are recognised by their byte-order marks and, without a mark,
// by a zero byte beside the first character. `name` is the file's name in the error.
[[nodiscard]] Result<std::string_view> without_byte_order_mark(std::string_view text,
                                                               std::string_view name);

// Returns `text` with each byte that belongs to no valid UTF-8 sequence as the Latin-1 character of
// that number. JSON, SVG and HTML hold UTF-8 only.
[[nodiscard]] std::string as_utf8(std::string_view text);

// Returns `text` as one line that a terminal shows: valid UTF-8 by as_utf8(), with a blank in place
// of each line break and other control character. Messages quote the bytes of damaged files.
[[nodiscard]] std::string as_printable_line(std::string_view text);

}  // namespace penumbra
