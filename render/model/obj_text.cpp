#include <algorithm>
#include <charconv>
#include <cmath>

#include "render/model/obj_parts.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kBlanks = " \t\r\v\f";

// Returns true for a decimal number beyond the range of doubles that is too small, not too large.
bool is_tiny(std::string_view number) {
  const std::size_t e = number.find_first_of("eE");
  const std::string_view mantissa = number.substr(0, e);
  const std::size_t point = std::min(mantissa.find('.'), mantissa.size());
  const std::size_t digit = std::min(mantissa.find_first_of("123456789"), mantissa.size());
  double power = static_cast<double>(point) - static_cast<double>(digit);
  if (e != std::string_view::npos) {
    std::string_view text = number.substr(e + 1);
    if (text.starts_with('+')) text.remove_prefix(1);
    std::int64_t exponent = 0;
    const auto error = std::from_chars(text.data(), text.data() + text.size(), exponent).ec;
    if (error != std::errc()) return text.starts_with('-');
    power += static_cast<double>(exponent);
  }
  return power < 0.0;
}

}  // namespace

std::vector<std::string_view> obj_words(std::string_view line) {
  std::vector<std::string_view> words;
  std::size_t at = 0;
  while (true) {
    at = line.find_first_not_of(kBlanks, at);
    if (at == std::string_view::npos || line[at] == '#') return words;
    const std::size_t end = std::min(line.find_first_of(kBlanks, at), line.size());
    words.push_back(line.substr(at, end - at));
    at = end;
  }
}

std::string_view after_keyword(std::string_view line) {
  for (int word = 0; word < 2; ++word) {
    line.remove_prefix(std::min(line.find_first_not_of(kBlanks), line.size()));
    if (word == 0) line.remove_prefix(std::min(line.find_first_of(kBlanks), line.size()));
  }
  const std::size_t last = line.find_last_not_of(kBlanks);
  return line.substr(0, last == std::string_view::npos ? 0 : last + 1);
}

std::optional<double> finite_number(std::string_view word) {
  if (word.starts_with('+') && !word.starts_with("+-")) word.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error == std::errc::result_out_of_range && end == word.data() + word.size() &&
      is_tiny(word)) {
    return 0.0;
  }
  if (error != std::errc() || end != word.data() + word.size() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

bool has_decimal_comma(std::string_view word) {
  const std::size_t comma = word.find(',');
  if (comma == std::string_view::npos) return false;
  std::string with_point(word);
  with_point[comma] = '.';
  return finite_number(with_point).has_value();
}

void LineWarnings::add(std::size_t line, std::string_view kind) {
  const auto known = std::ranges::find(kinds_, kind, &Kind::text);
  if (known == kinds_.end()) {
    kinds_.push_back({std::string(kind), line, line, 1});
  } else if (known->last_line != line) {
    known->last_line = line;
    ++known->count;
  }
}

void LineWarnings::append_to(std::vector<std::string>& warnings) const {
  for (const Kind& kind : kinds_) {
    std::string more;
    if (kind.count > 1) more = fmt::format(" ({} such lines)", kind.count);
    warnings.push_back(fmt::format("{}: line {}: {}{}", file_, kind.first_line, kind.text, more));
  }
}

}  // namespace penumbra
