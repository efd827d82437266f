// Byte-order marks at the head of text files, and text that is not UTF-8.
#pragma once

#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Returns `text` without a leading UTF-8 byte-order mark. Windows editors write one.
// Fails for UTF-16 and UTF-32, found by their byte-order marks or by a zero byte beside the first
// character. `name` is the file's name in the error.
[[nodiscard]] Result<std::string_view> without_byte_order_mark(std::string_view text,
                                                               std::string_view name);

// Returns valid UTF-8 for JSON, SVG and HTML: a byte that belongs to no valid sequence becomes the
// Latin-1 character of that number.
[[nodiscard]] std::string as_utf8(std::string_view text);

// Returns as_utf8() on one line: a blank replaces each line break and other control character.
[[nodiscard]] std::string as_printable_line(std::string_view text);

}  // namespace penumbra
