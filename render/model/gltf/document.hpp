// Parses the chunks of a .glb, and the JSON of a glTF file with tinygltf.
#pragma once

#include <tiny_gltf.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra::gltf {

struct Container {
  std::string_view json;
  std::optional<std::span<const std::uint8_t>> binary;  // the data of a .glb's first buffer
};

// Reads the chunks of a .glb; fails if one exceeds the file.
[[nodiscard]] Result<Container> open_glb(const std::string& name,
                                         std::span<const std::uint8_t> bytes);

// The source of a buffer's data.
struct BufferSource {
  std::string uri;  // percent-encoded file name, or a data URI; empty: none
  std::size_t byte_length = 0;
};

struct ImageSource {
  std::string uri;  // as in BufferSource
  int buffer_view = -1;
};

// An animation of the file; -1: absent.
struct AnimationSource {
  struct Sampler {
    int input = -1;   // accessor of the times
    int output = -1;  // accessor of the values
    std::string interpolation = "LINEAR";
  };
  struct Channel {
    int sampler = -1;
    int node = -1;
    std::string path;
  };
  std::string name;
  std::vector<Sampler> samplers;
  std::vector<Channel> channels;
  std::string fault;  // JSON path and error of a malformed field; then there are no channels
};

struct Document {
  // The parsed file without buffers, images, animations, cameras and top-level extensions. A
  // primitive's `indices` are stored as the attribute kIndicesKey.
  tinygltf::Model model;
  std::vector<BufferSource> buffers;
  std::vector<ImageSource> images;
  std::vector<AnimationSource> animations;
  std::size_t camera_count = 0;
  std::map<std::string, std::string> extensions;  // name -> JSON path of the first use
  std::vector<std::string> erased_fields;  // malformed fields of materials, with their values
};

inline constexpr const char* kIndicesKey = "indices";

// Parses the JSON text of a file. A field of a wrong type is an error that reports its JSON path.
[[nodiscard]] Result<Document> parse_document(const std::string& name, std::string_view json);

}  // namespace penumbra::gltf
