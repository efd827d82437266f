#include "render/model/gltf/accessors.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/propagate.hpp"
#include "render/model/gltf/compression/meshopt.hpp"

namespace penumbra::gltf {
namespace {

// Returns the value of a key, or 0.
template <std::size_t kCount>
std::size_t look_up(const std::array<std::pair<int, std::size_t>, kCount>& table, int key) {
  const auto entry = std::ranges::find(table, key, &std::pair<int, std::size_t>::first);
  return entry == table.end() ? 0 : entry->second;
}

}  // namespace

std::size_t component_size(int type) {
  static constexpr std::array<std::pair<int, std::size_t>, 6> kBytes = {
      {{TINYGLTF_COMPONENT_TYPE_BYTE, 1},
       {TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE, 1},
       {TINYGLTF_COMPONENT_TYPE_SHORT, 2},
       {TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT, 2},
       {TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, 4},
       {TINYGLTF_COMPONENT_TYPE_FLOAT, 4}}};
  return look_up(kBytes, type);
}

std::size_t component_count(int type) {
  static constexpr std::array<std::pair<int, std::size_t>, 5> kCounts = {
      {{TINYGLTF_TYPE_SCALAR, 1},
       {TINYGLTF_TYPE_VEC2, 2},
       {TINYGLTF_TYPE_VEC3, 3},
       {TINYGLTF_TYPE_VEC4, 4},
       {TINYGLTF_TYPE_MAT4, 16}}};
  return look_up(kCounts, type);
}

namespace {

template <class T>
T value_at(const std::uint8_t* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

}  // namespace

double component_at(const std::uint8_t* bytes, int type, bool normalised) {
  const auto scaled = [normalised](double value, double largest) {
    return normalised ? std::max(value / largest, -1.0) : value;
  };
  switch (type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
      return scaled(value_at<std::int8_t>(bytes), 127.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return scaled(value_at<std::uint8_t>(bytes), 255.0);
    case TINYGLTF_COMPONENT_TYPE_SHORT:
      return scaled(value_at<std::int16_t>(bytes), 32767.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return scaled(value_at<std::uint16_t>(bytes), 65535.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
      return value_at<std::uint32_t>(bytes);
    default:
      return value_at<float>(bytes);
  }
}

namespace {

void read_element(const std::uint8_t* from, const tinygltf::Accessor& accessor, double* to) {
  const std::size_t size = component_size(accessor.componentType);
  for (std::size_t c = 0; c < component_count(accessor.type); ++c) {
    to[c] = component_at(from + c * size, accessor.componentType, accessor.normalized);
  }
}

}  // namespace

bool is_unsigned(int component_type) {
  return component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE ||
         component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
         component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
}

Result<std::span<const std::uint8_t>> Accessors::stored_bytes(std::size_t buffer,
                                                              std::size_t offset,
                                                              std::size_t length,
                                                              const std::string& json_path) {
  if (buffer >= buffers_.count()) {
    return fail("{}: names buffer {}, there are {}", json_path, buffer, buffers_.count());
  }
  PENUMBRA_TRY(const std::span<const std::uint8_t> data, buffers_.bytes(buffer));
  if (offset > data.size() || length > data.size() - offset) {
    return fail("{}: reaches past the end of its buffer ({} bytes)", json_path, data.size());
  }
  return data.subspan(offset, length);
}

Result<std::span<const std::uint8_t>> Accessors::view_bytes(int view, const std::string& what) {
  if (!has(gltf_.bufferViews, view)) {
    return fail("{}: names buffer view {}, there are {}", what, view, gltf_.bufferViews.size());
  }
  if (const auto known = decoded_views_.find(view); known != decoded_views_.end())
    return std::span<const std::uint8_t>(known->second);
  const tinygltf::BufferView& v = gltf_.bufferViews[static_cast<std::size_t>(view)];
  const std::string json_path = fmt::format("bufferViews/{}", view);
  PENUMBRA_TRY(const auto compressed, meshopt_view(v, json_path));
  if (!compressed) {
    if (v.buffer < 0) return fail("{}: has no buffer; export the model again", json_path);
    return stored_bytes(static_cast<std::size_t>(v.buffer), v.byteOffset, v.byteLength, json_path);
  }
  // A compressed view's own buffer may have the same data uncompressed, or no data. It is not read,
  // because models often come without its file.
  if (compressed->decoded_bytes() > decoded_bytes_left_) {
    return fail("{}: the compressed data of the file has more than {} bytes; give a smaller model",
                compressed->json_path, limits_.max_file_bytes);
  }
  PENUMBRA_TRY(const auto coded, stored_bytes(compressed->buffer, compressed->byte_offset,
                                              compressed->byte_length, compressed->json_path));
  PENUMBRA_TRY(std::vector<std::uint8_t> decoded, decode_meshopt(*compressed, coded));
  decoded_bytes_left_ -= decoded.size();
  return std::span<const std::uint8_t>(decoded_views_[view] = std::move(decoded));
}

Result<Accessors::StridedRange> Accessors::strided_range(int view, const Layout& layout,
                                                         const std::string& what) {
  PENUMBRA_TRY(const std::span<const std::uint8_t> bytes, view_bytes(view, what));
  const tinygltf::BufferView& v = gltf_.bufferViews[static_cast<std::size_t>(view)];
  std::size_t stride = layout.size;
  if (layout.strided && v.byteStride != 0) {
    stride = v.byteStride;
    if (stride < layout.size || stride > 252 || stride % layout.alignment != 0) {
      return fail("bufferViews/{}: a byteStride of {} does not suit elements of {} bytes", view,
                  stride, layout.size);
    }
  }
  if (layout.offset % layout.alignment != 0 || v.byteOffset % layout.alignment != 0) {
    return fail("{}: is not aligned to its components of {} bytes", what, layout.alignment);
  }
  // count is at most 2^32 and stride 252: no overflow in 64 bits.
  const std::size_t needed = (layout.count - 1) * stride + layout.size;
  if (layout.offset > bytes.size() || needed > bytes.size() - layout.offset) {
    return fail("{}: reaches past the end of its buffer view ({} bytes)", what, bytes.size());
  }
  return StridedRange{bytes.data() + layout.offset, stride};
}

Result<void> Accessors::apply_sparse(const tinygltf::Accessor& accessor, Elements& elements,
                                     const std::string& json_path) {
  const auto& s = accessor.sparse;
  const std::size_t index_size = component_size(s.indices.componentType);
  const auto index_offset = static_cast<std::int64_t>(s.indices.byteOffset);
  const auto value_offset = static_cast<std::int64_t>(s.values.byteOffset);
  if (!is_unsigned(s.indices.componentType) || s.count <= 0 ||
      static_cast<std::size_t>(s.count) > accessor.count || index_offset < 0 || value_offset < 0) {
    return fail("{}: its sparse part is malformed", json_path);
  }
  const auto count = static_cast<std::size_t>(s.count);
  const std::size_t size = component_size(accessor.componentType);
  PENUMBRA_TRY(const StridedRange indices, strided_range(s.indices.bufferView,
                                                         {static_cast<std::size_t>(index_offset),
                                                          count, index_size, index_size, false},
                                                         json_path + " sparse indices"));
  PENUMBRA_TRY(const StridedRange values, strided_range(s.values.bufferView,
                                                        {static_cast<std::size_t>(value_offset),
                                                         count, size * elements.width, size, false},
                                                        json_path + " sparse values"));
  for (std::size_t i = 0; i < count; ++i) {
    const double to =
        component_at(indices.data + i * indices.stride, s.indices.componentType, false);
    if (!(to < static_cast<double>(accessor.count))) {
      return fail("{}: a sparse index is {}, there are {} elements", json_path, to, accessor.count);
    }
    read_element(values.data + i * values.stride, accessor,
                 elements.values.data() + static_cast<std::size_t>(to) * elements.width);
  }
  return {};
}

Result<Elements> Accessors::elements(int index, const std::string& what) {
  if (!has(gltf_.accessors, index)) {
    return fail("{}: names accessor {}, there are {}", what, index, gltf_.accessors.size());
  }
  const tinygltf::Accessor& accessor = gltf_.accessors[static_cast<std::size_t>(index)];
  const std::string json_path = fmt::format("{} (accessors/{})", what, index);
  const std::size_t size = component_size(accessor.componentType);
  const std::size_t width = component_count(accessor.type);
  // Columns of matrices with smaller components are padded, which is not supported.
  if (size == 0 || width == 0 || (width == 16 && size != 4)) {
    return fail("{}: its component type or shape is not one for this use", json_path);
  }
  // The longest accessors are indices, with three per triangle.
  const std::size_t max_count = std::max(limits_.max_vertices, 3 * limits_.max_triangles);
  if (accessor.count == 0 || accessor.count > max_count) {
    return fail("{}: has {} elements; 1 to {} can be read", json_path, accessor.count, max_count);
  }
  // Elements without a buffer view are zeros (glTF 2.0, 5.1.1).
  Elements result{accessor.count, width, {}};
  if (accessor.bufferView >= 0) {
    PENUMBRA_TRY(
        const StridedRange from,
        strided_range(accessor.bufferView,
                      {accessor.byteOffset, accessor.count, size * width, size, true}, json_path));
    result.values.resize(accessor.count * width);
    for (std::size_t i = 0; i < accessor.count; ++i) {
      read_element(from.data + i * from.stride, accessor, result.values.data() + i * width);
    }
  } else {
    if (accessor.count * width > zeros_left_) {
      return fail(
          "{}: has no buffer view; the file has more than {} numbers without data; export the "
          "model again",
          json_path, limits_.max_vertices);
    }
    zeros_left_ -= accessor.count * width;
    result.values.resize(accessor.count * width, 0.0);
  }
  if (accessor.sparse.isSparse) PENUMBRA_TRY_VOID(apply_sparse(accessor, result, json_path));
  return checked_elements(std::move(result), {width, width, 0}, json_path);
}

Result<Elements> checked_elements(Elements elements, const Shape& shape,
                                  const std::string& json_path) {
  for (const double value : elements.values) {
    if (!std::isfinite(value)) {
      return fail("{}: has a number that is not finite; export the model again", json_path);
    }
  }
  if (elements.width < shape.min_width || elements.width > shape.max_width) {
    return fail("{}: has {} components, {} to {} expected", json_path, elements.width,
                shape.min_width, shape.max_width);
  }
  if (shape.count != 0 && elements.count != shape.count) {
    return fail("{}: has {} elements for {} vertices", json_path, elements.count, shape.count);
  }
  return elements;
}

Result<Elements> Accessors::attribute(const std::map<std::string, int>& list,
                                      const std::string& key, const Shape& shape,
                                      const std::string& what) {
  const auto entry = list.find(key);
  if (entry == list.end()) return Elements{};
  const std::string json_path = what + "/" + key;
  PENUMBRA_TRY(Elements found, elements(entry->second, json_path));
  return checked_elements(std::move(found), shape, json_path);
}

}  // namespace penumbra::gltf
