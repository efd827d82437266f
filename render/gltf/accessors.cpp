// Buffer views and accessors: the numbers of a file, with every range checked.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "render/gltf/gltf_reader.hpp"

namespace penumbra {
namespace {

std::size_t component_size(int type) {
  switch (type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return 1;
    case TINYGLTF_COMPONENT_TYPE_SHORT:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return 2;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
    case TINYGLTF_COMPONENT_TYPE_FLOAT:
      return 4;
    default:
      return 0;
  }
}

std::size_t component_count(int type) {
  switch (type) {
    case TINYGLTF_TYPE_SCALAR:
      return 1;
    case TINYGLTF_TYPE_VEC2:
      return 2;
    case TINYGLTF_TYPE_VEC3:
      return 3;
    case TINYGLTF_TYPE_VEC4:
      return 4;
    default:
      return 0;
  }
}

template <class T>
T value_at(const std::uint8_t* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

// One component as a number; normalised integers by the formulas of the glTF specification 3.11.
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

}  // namespace

Result<std::span<const std::uint8_t>> GltfReader::view_bytes(int view,
                                                             const std::string& what) const {
  if (!has(gltf_.bufferViews, view)) {
    return fail("{}: {}: names buffer view {}, there are {}", name_, what, view,
                gltf_.bufferViews.size());
  }
  const tinygltf::BufferView& v = gltf_.bufferViews[static_cast<std::size_t>(view)];
  if (!has(gltf_.buffers, v.buffer)) {
    return fail("{}: bufferViews/{}: names buffer {}, there are {}", name_, view, v.buffer,
                gltf_.buffers.size());
  }
  const std::vector<unsigned char>& data = gltf_.buffers[static_cast<std::size_t>(v.buffer)].data;
  if (v.byteOffset > data.size() || v.byteLength > data.size() - v.byteOffset) {
    return fail("{}: bufferViews/{}: reaches past the end of its buffer ({} bytes)", name_, view,
                data.size());
  }
  return std::span<const std::uint8_t>(data).subspan(v.byteOffset, v.byteLength);
}

Result<GltfReader::Stretch> GltfReader::stretch(int view, std::size_t offset, std::size_t count,
                                                std::size_t size, std::size_t alignment,
                                                bool strided, const std::string& what) const {
  const Result<std::span<const std::uint8_t>> bytes = view_bytes(view, what);
  if (!bytes) return tl::unexpected(bytes.error());
  const tinygltf::BufferView& v = gltf_.bufferViews[static_cast<std::size_t>(view)];
  std::size_t stride = size;
  if (strided && v.byteStride != 0) {
    stride = v.byteStride;
    if (stride < size || stride > 252 || stride % alignment != 0) {
      return fail("{}: bufferViews/{}: a byteStride of {} does not suit elements of {} bytes",
                  name_, view, stride, size);
    }
  }
  if ((offset % alignment) != 0 || (v.byteOffset % alignment) != 0) {
    return fail("{}: {}: is not aligned to its components of {} bytes", name_, what, alignment);
  }
  // count is at most 2^32 and stride 252: no overflow in 64 bits.
  const std::size_t needed = (count - 1) * stride + size;
  if (offset > bytes->size() || needed > bytes->size() - offset) {
    return fail("{}: {}: reaches past the end of its buffer view ({} bytes)", name_, what,
                bytes->size());
  }
  return Stretch{bytes->data() + offset, stride};
}

Result<Elements> GltfReader::elements(int index, const std::string& what) const {
  if (!has(gltf_.accessors, index)) {
    return fail("{}: {}: names accessor {}, there are {}", name_, what, index,
                gltf_.accessors.size());
  }
  const tinygltf::Accessor& accessor = gltf_.accessors[static_cast<std::size_t>(index)];
  const std::string place = fmt::format("{} (accessors/{})", what, index);
  const std::size_t size = component_size(accessor.componentType);
  const std::size_t width = component_count(accessor.type);
  if (size == 0 || width == 0) {
    return fail("{}: {}: its component type or shape is not one for this use", name_, place);
  }
  // Indices may be up to three per triangle; nothing else is longer.
  const std::size_t most = std::max(limits_.max_vertices, 3 * limits_.max_triangles);
  if (accessor.count == 0 || accessor.count > most) {
    return fail("{}: {}: has {} elements; 1 to {} can be read", name_, place, accessor.count, most);
  }
  Elements result{accessor.count, width, {}};
  const bool sparse = accessor.sparse.isSparse;
  if (accessor.bufferView < 0 && !sparse) {
    return fail("{}: {}: has no buffer view, so no data", name_, place);
  }
  const auto fill = [&](const Stretch& from, std::size_t element, std::size_t to) {
    for (std::size_t c = 0; c < width; ++c) {
      result.values[to * width + c] = component_at(from.data + element * from.stride + c * size,
                                                   accessor.componentType, accessor.normalized);
    }
  };
  if (accessor.bufferView >= 0) {
    const Result<Stretch> from = stretch(accessor.bufferView, accessor.byteOffset, accessor.count,
                                         size * width, size, true, place);
    if (!from) return tl::unexpected(from.error());
    result.values.resize(accessor.count * width);
    for (std::size_t i = 0; i < accessor.count; ++i) fill(*from, i, i);
  } else {
    result.values.resize(accessor.count * width, 0.0);
  }
  if (sparse) {
    const auto& s = accessor.sparse;
    const std::size_t index_size = component_size(s.indices.componentType);
    const bool index_type = s.indices.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE ||
                            s.indices.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
                            s.indices.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
    if (!index_type || s.count <= 0 || static_cast<std::size_t>(s.count) > accessor.count ||
        s.indices.byteOffset < 0 || s.values.byteOffset < 0) {
      return fail("{}: {}: its sparse part is malformed", name_, place);
    }
    const auto count = static_cast<std::size_t>(s.count);
    const Result<Stretch> indices =
        stretch(s.indices.bufferView, static_cast<std::size_t>(s.indices.byteOffset), count,
                index_size, index_size, false, place + " sparse indices");
    if (!indices) return tl::unexpected(indices.error());
    const Result<Stretch> values =
        stretch(s.values.bufferView, static_cast<std::size_t>(s.values.byteOffset), count,
                size * width, size, false, place + " sparse values");
    if (!values) return tl::unexpected(values.error());
    for (std::size_t i = 0; i < count; ++i) {
      const double to =
          component_at(indices->data + i * indices->stride, s.indices.componentType, false);
      if (!(to < static_cast<double>(accessor.count))) {
        return fail("{}: {}: a sparse index is {}, there are {} elements", name_, place, to,
                    accessor.count);
      }
      fill(*values, i, static_cast<std::size_t>(to));
    }
  }
  for (const double value : result.values) {
    if (!std::isfinite(value)) {
      return fail("{}: {}: has a number that is not finite; export the model again", name_, place);
    }
  }
  return result;
}

// An attribute's elements; empty where the primitive has none.
Result<Elements> GltfReader::attribute(const tinygltf::Primitive& primitive, const std::string& key,
                                       std::size_t min_width, std::size_t max_width,
                                       std::size_t count, const std::string& what) const {
  const auto entry = primitive.attributes.find(key);
  if (entry == primitive.attributes.end()) return Elements{};
  const std::string place = what + "/attributes/" + key;
  Result<Elements> found = elements(entry->second, place);
  if (!found) return found;
  if (found->width < min_width || found->width > max_width) {
    return fail("{}: {}: has {} components, {} to {} expected", name_, place, found->width,
                min_width, max_width);
  }
  if (count != 0 && found->count != count) {
    return fail("{}: {}: has {} elements for {} vertices", name_, place, found->count, count);
  }
  return found;
}

}  // namespace penumbra
