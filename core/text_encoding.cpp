#include "core/text_encoding.hpp"

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

}  // namespace

Result<std::string_view> without_byte_order_mark(std::string_view text, std::string_view name) {
  if (const std::string_view encoding = wide_encoding(text); !encoding.empty()) {
    return fail("{}: is {} text; save it as UTF-8", name, encoding);
  }
  if (text.starts_with("\xEF\xBB\xBF"sv)) text.remove_prefix(3);
  return text;
}

}  // namespace penumbra
