// Reads buffer views and accessors and checks all ranges. Errors and warnings of the gltf classes
// contain the JSON path; read_gltf() adds the file's name.
#pragma once

#include <tiny_gltf.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/buffers.hpp"
#include "render/model/model.hpp"

namespace penumbra::gltf {

template <class T>
[[nodiscard]] bool has(const std::vector<T>& list, int index) {
  return index >= 0 && static_cast<std::size_t>(index) < list.size();
}

// The numbers of an accessor: `count` elements of `width` components each.
struct Elements {
  std::size_t count = 0;
  std::size_t width = 0;
  std::vector<double> values;

  [[nodiscard]] double at(std::size_t element, std::size_t component) const {
    return values[element * width + component];
  }
};

// The required size of an attribute. Any component type is allowed (KHR_mesh_quantization).
struct Shape {
  std::size_t min_width = 1;
  std::size_t max_width = 1;
  std::size_t count = 0;  // number of elements; 0: any
};

class Accessors {
 public:
  Accessors(const tinygltf::Model& gltf, Buffers& buffers, const ModelLimits& limits)
      : gltf_(gltf),
        buffers_(buffers),
        limits_(limits),
        zeros_left_(limits.max_vertices),
        decoded_bytes_left_(limits.max_file_bytes) {}

  // Returns the bytes of a buffer view, decoded if they are compressed.
  [[nodiscard]] Result<std::span<const std::uint8_t>> view_bytes(int view, const std::string& what);
  // `what`: the JSON path that refers to the accessor.
  [[nodiscard]] Result<Elements> elements(int accessor, const std::string& what);
  // Returns the elements of the accessor list[key], or no elements if there is no such key. `what`:
  // the JSON path of the list.
  [[nodiscard]] Result<Elements> attribute(const std::map<std::string, int>& list,
                                           const std::string& key, const Shape& shape,
                                           const std::string& what);
  // Returns an accessor, for checks of its component type, or nullptr if the index is out of range.
  [[nodiscard]] const tinygltf::Accessor* find(int accessor) const {
    return has(gltf_.accessors, accessor) ? &gltf_.accessors[static_cast<std::size_t>(accessor)]
                                          : nullptr;
  }

 private:
  // A checked range of a buffer: elements that are `stride` bytes apart.
  struct StridedRange {
    const std::uint8_t* data = nullptr;
    std::size_t stride = 0;
  };
  struct Layout {
    std::size_t offset = 0;
    std::size_t count = 0;
    std::size_t size = 0;  // bytes per element
    std::size_t alignment = 0;
    bool strided = false;
  };
  // Returns bytes of a buffer as they are in the file. `json_path`: what names the buffer.
  [[nodiscard]] Result<std::span<const std::uint8_t>> stored_bytes(std::size_t buffer,
                                                                   std::size_t offset,
                                                                   std::size_t length,
                                                                   const std::string& json_path);
  [[nodiscard]] Result<StridedRange> strided_range(int view, const Layout& layout,
                                                   const std::string& what);
  [[nodiscard]] Result<void> apply_sparse(const tinygltf::Accessor& accessor, Elements& elements,
                                          const std::string& json_path);

  const tinygltf::Model& gltf_;
  Buffers& buffers_;
  const ModelLimits& limits_;
  // Number of zeros that accessors without a buffer view may still add. Without a limit, a small
  // file could exhaust the memory.
  std::size_t zeros_left_;
  // Likewise for compressed buffer views: number of bytes that they may still be decoded to.
  std::size_t decoded_bytes_left_;
  std::map<int, std::vector<std::uint8_t>> decoded_views_;
};

// Returns the elements if they are finite and have the shape.
[[nodiscard]] Result<Elements> checked_elements(Elements elements, const Shape& shape,
                                                const std::string& json_path);

// Return the size in bytes and the number of glTF's types; 0 for unknown ones.
[[nodiscard]] std::size_t component_size(int component_type);
[[nodiscard]] std::size_t component_count(int type);

// Returns one component as a number; converts normalised integers by glTF 2.0, section 3.11.
[[nodiscard]] double component_at(const std::uint8_t* bytes, int type, bool normalised);

// Returns true for component types of unsigned integers.
[[nodiscard]] bool is_unsigned(int component_type);

}  // namespace penumbra::gltf
