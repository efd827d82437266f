// Byte-order marks at the head of text files.
#pragma once

#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Returns `text` without a leading UTF-8 byte-order mark. Windows editors write one.
// Fails for UTF-16 and UTF-32, which are recognised by their byte-order marks and, without a mark,
// by a zero byte beside the first character. `name` is the file's name in the error.
[[nodiscard]] Result<std::string_view> without_byte_order_mark(std::string_view text,
                                                               std::string_view name);

}  // namespace penumbra
