#include "render/model/gltf/buffers.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra::gltf {
namespace {

constexpr std::string_view kDataScheme = "data:";
constexpr std::string_view kBase64 = "base64";

bool equal_ignoring_case(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](unsigned char x, unsigned char y) {
    return std::tolower(x) == std::tolower(y);
  });
}

// Returns the 6-bit value of each base64 character; -1 for other characters.
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
  int count = 0;  // number of bits not yet written
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

// Decodes percent escapes (RFC 3986). A '%' without two hex digits is kept.
std::string percent_decoded(std::string_view text) {
  std::string decoded;
  decoded.reserve(text.size());
  for (std::size_t i = 0; i < text.size(); ++i) {
    const std::string_view digits = text.substr(i + 1, 2);
    unsigned byte = 0;
    const char* const end = digits.data() + digits.size();
    if (text[i] == '%' && digits.size() == 2 &&
        std::from_chars(digits.data(), end, byte, 16).ptr == end) {
      decoded.push_back(static_cast<char>(byte));
      i += 2;
    } else {
      decoded.push_back(text[i]);
    }
  }
  return decoded;
}

// Returns the data of a data URI of any media type: base64 or percent-encoded.
Result<std::vector<std::uint8_t>> decode_data_uri(std::string_view uri) {
  const std::size_t comma = uri.find(',');
  if (comma == std::string_view::npos) {
    return fail("\"{}\": is a data URI without data; export the model again", shortened(uri, 40));
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

bool is_file(const std::filesystem::path& path) {
  std::error_code ignored;  // e.g. the name is too long
  return std::filesystem::is_regular_file(path, ignored);
}

}  // namespace

bool is_data_uri(std::string_view uri) {
  return equal_ignoring_case(uri.substr(0, kDataScheme.size()), kDataScheme);
}

Buffers::Buffers(const std::filesystem::path& file, std::vector<BufferSource> sources,
                 std::optional<std::span<const std::uint8_t>> binary, std::size_t max_bytes)
    : folder_(file.parent_path()),
      sources_(std::move(sources)),
      binary_(binary),
      bytes_left_(max_bytes),
      fetched_(sources_.size()) {}

bool Buffers::has_data(std::size_t buffer) const {
  return !sources_[buffer].uri.empty() || (buffer == 0 && binary_);
}

Result<std::span<const std::uint8_t>> Buffers::bytes(std::size_t buffer) {
  const BufferSource& source = sources_[buffer];
  if (!has_data(buffer)) {
    return fail("buffers/{}: has neither a uri nor data in a .glb; export the model again", buffer);
  }
  std::span<const std::uint8_t> data;
  if (source.uri.empty()) {
    data = *binary_;
  } else {
    std::optional<std::vector<std::uint8_t>>& fetched = fetched_[buffer];
    if (!fetched) {
      Result<std::vector<std::uint8_t>> read = fetch(source.uri);
      if (!read) return fail_in(fmt::format("buffers/{}", buffer), read.error());
      fetched = std::move(*read);
    }
    data = *fetched;
  }
  if (data.size() < source.byte_length) {
    return fail("buffers/{}/byteLength: is {}, but its data has {} bytes; export the model again",
                buffer, source.byte_length, data.size());
  }
  return data.first(source.byte_length);
}

Result<std::vector<std::uint8_t>> Buffers::fetch(std::string_view uri) {
  if (is_data_uri(uri)) return decode_data_uri(uri);
  // The file's name may contain a literal '%'.
  Result<std::filesystem::path> file = model_resource_path(folder_, percent_decoded(uri));
  if (file && !is_file(*file)) {
    const Result<std::filesystem::path> literal = model_resource_path(folder_, uri);
    if (literal && is_file(*literal)) file = literal;
  }
  if (!file) return tl::unexpected(file.error());
  if (!is_file(*file)) return fail("{}: not found; put it beside the model", file->string());
  PENUMBRA_TRY(std::vector<std::uint8_t> read, read_file(*file, bytes_left_));
  bytes_left_ -= read.size();
  files_.push_back(*file);
  if (leaves_folder(percent_decoded(uri))) {
    warnings_.push_back(fmt::format("\"{}\" is outside the model's folder; {} is used",
                                    shortened(uri, 200), file->string()));
  }
  return read;
}

}  // namespace penumbra::gltf
