#include "app/recording/frame_range.hpp"

#include <charconv>
#include <string_view>

namespace penumbra {

std::optional<FrameRange> parse_frame_range(const std::string& text) {
  const std::size_t colon = text.find(':');
  if (colon == std::string::npos) return std::nullopt;
  const auto number = [](std::string_view part) -> std::optional<int> {
    int value = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    if (error != std::errc() || end != part.data() + part.size() || value < 0) return std::nullopt;
    return value;
  };
  const std::string_view first = std::string_view(text).substr(0, colon);
  const std::string_view last = std::string_view(text).substr(colon + 1);
  FrameRange range;
  if (!first.empty()) {
    const auto value = number(first);
    if (!value) return std::nullopt;
    range.first = *value;
  }
  if (!last.empty()) {
    range.last = number(last);
    if (!range.last || *range.last <= range.first) return std::nullopt;
  }
  return range;
}

}  // namespace penumbra
