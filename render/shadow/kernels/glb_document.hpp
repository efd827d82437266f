// A glTF document that is edited and written as one .glb. Internal to kernels/.
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
#include "render/shadow/kernels/kernel_file.hpp"

namespace penumbra {

class GlbDocument {
 public:
  using Json = nlohmann::ordered_json;

  GlbDocument() = default;
  // Opens a .glb or .gltf with its external buffers and images. An image that can't be read stays a
  // reference by name and adds a line to `warnings`.
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
  std::size_t add(const std::vector<T>& data, int component, const char* type, int target) {
    const std::span<const T> values(data);
    const std::size_t view =
        add_view({reinterpret_cast<const std::uint8_t*>(data.data()), values.size_bytes()}, target);
    json["accessors"].push_back({{"bufferView", view},
                                 {"componentType", component},
                                 {"count", data.size()},
                                 {"type", type}});
    return json["accessors"].size() - 1;
  }
  std::size_t add_vectors(const std::vector<glm::vec3>& vectors) {
    return add(vectors, kFloat, "VEC3", kArrayBuffer);
  }

  // Replaces bytes of the binary chunk; returns false if they exceed the chunk.
  [[nodiscard]] bool overwrite(std::size_t offset, std::span<const glm::vec3> vectors);

  // Returns the bytes of the .glb file.
  [[nodiscard]] Result<std::vector<std::uint8_t>> finish();

 private:
  std::vector<std::uint8_t> binary_;
};

// Returns the media type of a PNG or JPEG, detected by its first bytes; "" for other formats.
[[nodiscard]] std::string media_type_of(std::span<const std::uint8_t> image);

// Converts from the object frame (z up) to the file's axes (y up).
[[nodiscard]] inline Eigen::Vector3d to_file_axes(const Eigen::Vector3d& p) {
  return {p.x(), p.z(), -p.y()};
}
[[nodiscard]] inline glm::vec3 to_file_axes(const glm::vec3& p) {
  return {p.x, p.z, p.y == 0.0F ? 0.0F : -p.y};
}

// Writes the kernels' stamp, groups and direction (in the mesh's axes) into the JSON of a mesh.
void write_extras(GlbDocument::Json& mesh, const KernelFile& kernels, const Eigen::Vector3d& up);

}  // namespace penumbra
