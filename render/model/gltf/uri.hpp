// URIs of glTF files: percent escapes (RFC 3986) and embedded data (RFC 2397).
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra::gltf {

// Replaces percent escapes by their bytes. '+' stands for itself, and so does a '%' that begins no
// escape.
[[nodiscard]] std::string percent_decoded(std::string_view text);

[[nodiscard]] bool is_data_uri(std::string_view uri);

// Returns the data of a data URI of any media type: base64 or percent-encoded.
[[nodiscard]] Result<std::vector<std::uint8_t>> decode_data_uri(std::string_view uri);

}  // namespace penumbra::gltf
