// A glTF document that is edited and written as one .glb.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <glm/vec3.hpp>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

class GlbDocument {
 public:
  using Json = nlohmann::ordered_json;

  GlbDocument() = default;
  // A .glb or .gltf with the buffers and pictures that lie beside it. A picture that can't be had
  // keeps its name and gets a line in `warnings`.
  [[nodiscard]] static Result<GlbDocument> open(const std::filesystem::path& file,
                                                std::vector<std::string>& warnings);

  Json json;

  static constexpr int kArrayBuffer = 34962;
  static constexpr int kElementArrayBuffer = 34963;
  static constexpr int kFloat = 5126;
  static constexpr int kUnsignedInt = 5125;

  // Adds a buffer view; returns its index.
  std::size_t add_view(std::span<const std::uint8_t> bytes, std::optional<int> target = {});
  // Adds an accessor and a buffer view for it; returns the accessor's index.
  template <class T>
  std::size_t add(std::span<const T> data, int component, const char* type, std::size_t count,
                  int target) {
    const std::size_t view =
        add_view({reinterpret_cast<const std::uint8_t*>(data.data()), data.size_bytes()}, target);
    json["accessors"].push_back(
        {{"bufferView", view}, {"componentType", component}, {"count", count}, {"type", type}});
    return json["accessors"].size() - 1;
  }
  std::size_t add_vectors(std::span<const glm::vec3> vectors);

  // Replaces bytes of the binary chunk; false where they are not there.
  [[nodiscard]] bool overwrite(std::size_t offset, std::span<const glm::vec3> vectors);

  // The bytes of the file.
  [[nodiscard]] Result<std::vector<std::uint8_t>> finish();

 private:
  std::vector<std::uint8_t> binary_;
};

// The media type of a PNG or JPEG by its first bytes; "" of others.
[[nodiscard]] std::string media_type_of(std::span<const std::uint8_t> image);

}  // namespace penumbra
