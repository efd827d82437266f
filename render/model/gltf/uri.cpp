#include "render/model/gltf/uri.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <optional>

namespace penumbra::gltf {
namespace {

constexpr std::string_view kDataScheme = "data:";
constexpr std::string_view kBase64 = "base64";

bool equal_ignoring_case(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](unsigned char x, unsigned char y) {
    return std::tolower(x) == std::tolower(y);
  });
}

std::optional<int> hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return std::nullopt;
}

// The 6 bits of each character of the base64 alphabet, -1 of others.
constexpr std::array<std::int8_t, 256> base64_values() {
  constexpr std::string_view kAlphabet =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::array<std::int8_t, 256> values{};
  values.fill(-1);
  for (std::size_t i = 0; i < kAlphabet.size(); ++i) {
    values[static_cast<unsigned char>(kAlphabet[i])] = static_cast<std::int8_t>(i);
  }
  return values;
}

Result<std::vector<std::uint8_t>> base64_decoded(std::string_view text) {
  static constexpr std::array<std::int8_t, 256> kValues = base64_values();
  std::vector<std::uint8_t> bytes;
  bytes.reserve(text.size() / 4 * 3 + 2);
  std::uint32_t bits = 0;
  int count = 0;  // of bits that are not written yet
  bool padded = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto c = static_cast<unsigned char>(text[i]);
    if (std::isspace(c) != 0) continue;
    if (c == '=') {
      padded = true;
      continue;
    }
    if (kValues[c] < 0 || padded) {
      return fail("its base64 data is malformed at character {}; export the model again", i);
    }
    bits = bits << 6U | static_cast<std::uint32_t>(kValues[c]);
    count += 6;
    if (count >= 8) {
      count -= 8;
      bytes.push_back(static_cast<std::uint8_t>(bits >> static_cast<unsigned>(count)));
    }
  }
  return bytes;
}

}  // namespace

std::string percent_decoded(std::string_view text) {
  std::string decoded;
  decoded.reserve(text.size());
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '%' && i + 2 < text.size()) {
      const std::optional<int> high = hex_digit(text[i + 1]), low = hex_digit(text[i + 2]);
      if (high && low) {
        decoded.push_back(static_cast<char>(*high * 16 + *low));
        i += 2;
        continue;
      }
    }
    decoded.push_back(text[i]);
  }
  return decoded;
}

bool is_data_uri(std::string_view uri) {
  return equal_ignoring_case(uri.substr(0, kDataScheme.size()), kDataScheme);
}

Result<std::vector<std::uint8_t>> decode_data_uri(std::string_view uri) {
  const std::size_t comma = uri.find(',');
  if (!is_data_uri(uri) || comma == std::string_view::npos) {
    return fail("\"{}\": is a data URI without data; export the model again", uri.substr(0, 40));
  }
  // data:[media type][;parameter]...[;base64],
  const std::string_view head = uri.substr(0, comma);
  const bool base64 = head.size() > kBase64.size() &&
                      head[head.size() - kBase64.size() - 1] == ';' &&
                      equal_ignoring_case(head.substr(head.size() - kBase64.size()), kBase64);
  const std::string_view data = uri.substr(comma + 1);
  if (base64 && data.find('%') == std::string_view::npos) return base64_decoded(data);
  const std::string decoded = percent_decoded(data);
  if (base64) return base64_decoded(decoded);
  return std::vector<std::uint8_t>(decoded.begin(), decoded.end());
}

}  // namespace penumbra::gltf
