#include "render/model/gltf/container.hpp"

#include <algorithm>
#include <cstring>

namespace penumbra::gltf {
namespace {

std::uint32_t word_at(std::span<const std::uint8_t> bytes, std::size_t offset) {
  std::uint32_t word = 0;  // glTF is little-endian, like every machine this runs on
  std::memcpy(&word, bytes.data() + offset, 4);
  return word;
}

}  // namespace

Result<Container> open_glb(const std::string& name, std::span<const std::uint8_t> bytes) {
  constexpr std::uint32_t kMagic = 0x46546C67, kJson = 0x4E4F534A, kBinary = 0x004E4942;
  if (bytes.size() >= 4 && bytes.size() < 20 && word_at(bytes, 0) == kMagic) {
    return fail("{}: is cut short; export it again", name);
  }
  if (bytes.size() < 20 || word_at(bytes, 0) != kMagic) {
    return fail("{}: is not a binary glTF file (it does not start with \"glTF\"); export it again",
                name);
  }
  if (word_at(bytes, 4) != 2) {
    return fail("{}: is glTF version {}; export it as version 2", name, word_at(bytes, 4));
  }
  const std::size_t length = word_at(bytes, 8);
  if (length > bytes.size()) {
    return fail("{}: is cut off: {} of {} bytes; copy or export it again", name, bytes.size(),
                length);
  }
  Container container;
  std::size_t offset = 12;
  for (int chunk = 0; offset < length; ++chunk) {
    if (length - offset < 8 || word_at(bytes, offset) > length - offset - 8) {
      return fail("{}: chunk {} reaches past the end of the file; export it again", name, chunk);
    }
    const std::size_t size = word_at(bytes, offset);
    if (chunk == 0) {
      if (word_at(bytes, offset + 4) != kJson) {
        return fail("{}: its first chunk is not JSON; export it again", name);
      }
      container.json = {reinterpret_cast<const char*>(bytes.data()) + offset + 8, size};
    } else if (chunk == 1 && word_at(bytes, offset + 4) == kBinary) {
      container.binary = bytes.subspan(offset + 8, size);
    }
    offset += 8 + size;
  }
  return container;
}

int nesting_depth(std::string_view json) {
  int depth = 0, deepest = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < json.size(); ++i) {
    const char c = json[i];
    if (in_string) {
      if (c == '\\') ++i;
      in_string = c != '"';
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      deepest = std::max(deepest, ++depth);
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return deepest;
}

}  // namespace penumbra::gltf
