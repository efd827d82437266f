// Text in UTF-16, as some editors save it.
#pragma once

#include <string>
#include <string_view>

namespace penumbra::test {

// ASCII text as UTF-16, little-endian, with or without its byte-order mark.
inline std::string as_utf16(std::string_view text, bool with_mark) {
  std::string wide = with_mark ? "\xFF\xFE" : "";
  for (const char c : text) {
    wide += c;
    wide += '\0';
  }
  return wide;
}

}  // namespace penumbra::test
