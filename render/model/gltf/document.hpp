// The JSON of a glTF file: typed fields, and what tinygltf makes of them.
#pragma once

#include <tiny_gltf.h>

#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra::gltf {

// The source of a buffer's data.
struct BufferSource {
  std::string uri;  // percent-encoded, or a data URI; empty: none
  std::size_t byte_length = 0;
};

struct ImageSource {
  std::string uri;  // as of a buffer
  int buffer_view = -1;
};

// The number of `extensions` objects that have an extension, and the place of the first.
struct ExtensionUse {
  std::size_t count = 0;
  std::string first_place;
};

struct Document {
  // Without buffers, images, animations, cameras and extensions of the file as a whole. A
  // primitive's `indices` are one of its attributes.
  tinygltf::Model model;
  std::vector<BufferSource> buffers;
  std::vector<ImageSource> images;
  std::size_t animation_count = 0;
  std::size_t camera_count = 0;
  std::map<std::string, ExtensionUse> extensions;
  std::vector<std::string> erased_fields;  // of materials: malformed, with what they were
};

// The name of the attribute that holds a primitive's `indices`.
inline constexpr const char* kIndicesKey = "indices";

// Parses the JSON text of a file. Fields of a wrong type are refused by their place.
[[nodiscard]] Result<Document> parse_document(const std::string& name, std::string_view json);

}  // namespace penumbra::gltf
