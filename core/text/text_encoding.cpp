#include "core/text/text_encoding.hpp"

#include <array>
#include <cstdint>

namespace penumbra {
namespace {

using namespace std::string_view_literals;

// Name of the wide encoding, or empty.
std::string_view wide_encoding(std::string_view text) {
  // UTF-32 first: its little-endian mark starts with that of UTF-16.
  if (text.starts_with("\xFF\xFE\0\0"sv) || text.starts_with("\0\0\xFE\xFF"sv)) return "UTF-32";
  if (text.starts_with("\xFF\xFE"sv) || text.starts_with("\xFE\xFF"sv)) return "UTF-16";
  if (text.size() >= 4 && text[0] != '\0' && text[1] == '\0' && text[2] != '\0' && text[3] == '\0')
    return "UTF-16";
  if (text.size() >= 4 && text[0] == '\0' && text[1] != '\0' && text[2] == '\0' && text[3] != '\0')
    return "UTF-16";
  return {};
}

// Length of the valid UTF-8 sequence that `text` starts with, or 0.
std::size_t utf8_sequence_length(std::string_view text) {
  const auto byte_at = [&](std::size_t i) { return static_cast<std::uint8_t>(text[i]); };
  const std::uint8_t lead = byte_at(0);
  if (lead < 0x80U) return 1;
  const std::size_t length = lead >= 0xF0U ? 4 : lead >= 0xE0U ? 3 : 2;
  if (lead < 0xC2U || lead > 0xF4U || text.size() < length) return 0;
  std::uint32_t code = lead & (0xFFU >> (length + 1));
  for (std::size_t i = 1; i < length; ++i) {
    if ((byte_at(i) & 0xC0U) != 0x80U) return 0;
    code = (code << 6U) | (byte_at(i) & 0x3FU);
  }
  // Overlong forms, surrogates and codes past the last plane are not valid.
  constexpr std::array<std::uint32_t, 5> kLeast = {0, 0, 0x80, 0x800, 0x10000};
  const bool surrogate = code >= 0xD800U && code <= 0xDFFFU;
  return code < kLeast[length] || code > 0x10FFFFU || surrogate ? 0 : length;
}

}  // namespace

Result<std::string_view> without_byte_order_mark(std::string_view text, std::string_view name) {
  if (const std::string_view encoding = wide_encoding(text); !encoding.empty()) {
    return fail("{}: is {} text; save it as UTF-8", name, encoding);
  }
  if (text.starts_with("\xEF\xBB\xBF"sv)) text.remove_prefix(3);
  return text;
}

std::string as_utf8(std::string_view text) {
  std::string converted;
  while (!text.empty()) {
    const std::size_t length = utf8_sequence_length(text);
    if (length > 0) {
      converted += text.substr(0, length);
      text.remove_prefix(length);
      continue;
    }
    const auto byte = static_cast<std::uint8_t>(text.front());
    converted += static_cast<char>(0xC0U | (byte >> 6U));
    converted += static_cast<char>(0x80U | (byte & 0x3FU));
    text.remove_prefix(1);
  }
  return converted;
}

std::string as_printable_line(std::string_view text) {
  std::string line = as_utf8(text);
  for (std::size_t i = 0; i < line.size(); ++i) {
    const auto byte = static_cast<std::uint8_t>(line[i]);
    if (byte < 0x20U || byte == 0x7FU) line[i] = ' ';
    // U+0080 to U+009F are control characters as well.
    if (byte == 0xC2U && i + 1 < line.size() && static_cast<std::uint8_t>(line[i + 1]) < 0xA0U) {
      line[i] = ' ';
      line.erase(i + 1, 1);
    }
  }
  return line;
}

}  // namespace penumbra
