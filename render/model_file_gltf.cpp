// glTF 2.0 (.glb, .gltf) -> Model, through tinygltf, in the file's own axes (y up). tinygltf reads
// the JSON and fetches buffers; what it returns is not trusted: containers are checked before it,
// every index, range and number after it.
#include <tiny_gltf.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <limits>
#include <optional>
#include <unordered_map>

#include "core/file.hpp"
#include "render/model_parts.hpp"

namespace penumbra {
namespace {

// tinygltf is told this folder; the file callbacks put the model's own in its place.
constexpr std::string_view kModelFolder = "model-folder:";

// --- before tinygltf ---

std::uint32_t word_at(std::span<const std::uint8_t> bytes, std::size_t offset) {
  std::uint32_t word = 0;  // glTF is little-endian, like every machine this runs on
  std::memcpy(&word, bytes.data() + offset, 4);
  return word;
}

// The JSON text of a .glb, after a walk over its chunks: tinygltf 2.7.0 lets a binary chunk reach
// 8 bytes past the end of the file.
Result<std::string_view> json_chunk(const std::string& name, std::span<const std::uint8_t> bytes) {
  constexpr std::uint32_t kMagic = 0x46546C67, kJson = 0x4E4F534A;
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
  std::string_view json;
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
      json = {reinterpret_cast<const char*>(bytes.data()) + offset + 8, size};
    }
    offset += 8 + size;
  }
  return json;
}

// How deep brackets nest, strings left out: tinygltf walks over `extras` by recursion.
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

// Files beside the model, for tinygltf's callbacks.
struct Neighbours {
  std::filesystem::path folder;
  std::size_t bytes_left = 0;
  std::string refused;  // why the last file could not be had

  [[nodiscard]] std::optional<std::filesystem::path> find(const std::string& path) {
    if (!path.starts_with(kModelFolder)) return std::nullopt;  // tinygltf's try in "."
    std::string_view name = std::string_view(path).substr(kModelFolder.size());
    if (name.starts_with('/')) name.remove_prefix(1);
    const Result<std::filesystem::path> file = beside_model(folder, name);
    if (!file) {
      refused = file.error().message;
      return std::nullopt;
    }
    if (!std::filesystem::is_regular_file(*file)) {
      refused = file->string() + ": not found; put it beside the model";
      return std::nullopt;
    }
    return *file;
  }
};

bool neighbour_exists(const std::string& path, void* user) {
  return static_cast<Neighbours*>(user)->find(path).has_value();
}

std::string same_path(const std::string& path, void*) {
  return path;
}

bool read_neighbour(std::vector<unsigned char>* bytes, std::string* error, const std::string& path,
                    void* user) {
  auto& neighbours = *static_cast<Neighbours*>(user);
  const auto file = neighbours.find(path);
  if (!file) return false;
  Result<std::vector<std::uint8_t>> read = read_file(*file, neighbours.bytes_left);
  if (!read) {
    neighbours.refused = read.error().message;
    if (error != nullptr) *error = neighbours.refused;
    return false;
  }
  neighbours.bytes_left -= read->size();
  *bytes = std::move(*read);
  return true;
}

bool write_nothing(std::string*, const std::string&, const std::vector<unsigned char>&, void*) {
  return false;
}

// Keeps a picture's coded bytes; decoding comes when a material uses it. Pictures in a buffer view
// are taken from there, after the view has been checked: the pointer given here has not been.
bool keep_picture(tinygltf::Image* image, const int, std::string*, std::string*, int, int,
                  const unsigned char* bytes, int size, void*) {
  if (image->bufferView < 0 && bytes != nullptr && size > 0)
    image->image.assign(bytes, bytes + size);
  return true;
}

// --- after tinygltf ---

template <class T>
bool has(const std::vector<T>& list, int index) {
  return index >= 0 && static_cast<std::size_t>(index) < list.size();
}

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

// The numbers of an accessor: `count` elements of `width` components.
struct Elements {
  std::size_t count = 0;
  std::size_t width = 0;
  std::vector<double> values;

  [[nodiscard]] double at(std::size_t element, std::size_t component) const {
    return values[element * width + component];
  }
};

class GltfReader {
 public:
  GltfReader(std::string name, const tinygltf::Model& gltf, const ModelLimits& limits)
      : name_(std::move(name)), gltf_(gltf), limits_(limits) {}

  [[nodiscard]] Result<Model> read();

 private:
  // A stretch of a buffer, checked: `count` elements of `size` bytes, `stride` apart.
  struct Stretch {
    const std::uint8_t* data = nullptr;
    std::size_t stride = 0;
  };
  [[nodiscard]] Result<std::span<const std::uint8_t>> view_bytes(int view,
                                                                 const std::string& what) const;
  [[nodiscard]] Result<Stretch> stretch(int view, std::size_t offset, std::size_t count,
                                        std::size_t size, std::size_t alignment, bool strided,
                                        const std::string& what) const;
  [[nodiscard]] Result<Elements> elements(int accessor, const std::string& what) const;
  [[nodiscard]] Result<Elements> attribute(const tinygltf::Primitive& primitive,
                                           const std::string& key, std::size_t min_width,
                                           std::size_t max_width, std::size_t count,
                                           const std::string& what) const;
  [[nodiscard]] Result<std::vector<std::uint32_t>> triangles(const tinygltf::Primitive& primitive,
                                                             std::size_t vertices,
                                                             const std::string& what) const;
  [[nodiscard]] Result<void> read_materials();
  [[nodiscard]] Result<int> image(int index, const std::string& what);
  // `info`: one of tinygltf's kinds of texture reference.
  template <class Info>
  [[nodiscard]] Result<MaterialTexture> texture(const Info& info, const std::string& what,
                                                std::vector<int>& texcoord_sets);
  [[nodiscard]] Result<TextureSampling> sampling(int index) const;
  [[nodiscard]] Result<Mesh> read_primitive(const tinygltf::Primitive& primitive,
                                            const std::string& what);
  [[nodiscard]] Result<void> read_meshes();
  [[nodiscard]] Result<Eigen::Matrix4d> node_matrix(const tinygltf::Node& node,
                                                    const std::string& what) const;
  [[nodiscard]] Result<void> place_node(int index, const Eigen::Matrix4d& T_root_parent, int depth,
                                        int parent = -1);
  void take_kernel_extras(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                          const std::string& what);
  [[nodiscard]] Result<void> place_mesh(int mesh, const Eigen::Matrix4d& T_root_node,
                                        const std::string& what, std::uint32_t node);
  std::uint32_t add_node(const std::string& node, int mesh, int parent);

  std::string name_;
  const tinygltf::Model& gltf_;
  const ModelLimits& limits_;
  Model model_;
  std::vector<std::vector<Mesh>> meshes_;  // per glTF mesh its primitives, in the mesh's frame
  std::vector<bool> placed_;               // per node
  bool kernels_disagree_ = false;
  std::unordered_map<int, int> image_index_;     // glTF image -> Model::textures
  std::vector<std::vector<int>> texcoord_sets_;  // per material, those that its textures use
  std::unordered_map<int, std::size_t> mesh_of_material_;  // -> Model::meshes
  std::size_t placed_vertices_ = 0;                        // by the nodes so far
  std::size_t placed_triangles_ = 0;
};

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

// Indices of a triangle list; strips and fans are written out.
Result<std::vector<std::uint32_t>> GltfReader::triangles(const tinygltf::Primitive& primitive,
                                                         std::size_t vertices,
                                                         const std::string& what) const {
  std::vector<std::uint32_t> order;
  if (primitive.indices < 0) {
    order.resize(vertices);
    for (std::size_t i = 0; i < vertices; ++i) order[i] = static_cast<std::uint32_t>(i);
  } else {
    const std::string place = what + "/indices";
    const Result<Elements> indices = elements(primitive.indices, place);
    if (!indices) return tl::unexpected(indices.error());
    const tinygltf::Accessor& accessor =
        gltf_.accessors[static_cast<std::size_t>(primitive.indices)];
    const bool whole = accessor.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE ||
                       accessor.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
                       accessor.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
    if (indices->width != 1 || !whole || accessor.normalized) {
      return fail("{}: {}: are not unsigned integers", name_, place);
    }
    order.reserve(indices->count);
    for (const double index : indices->values) {
      if (!(index < static_cast<double>(vertices))) {
        return fail("{}: {}: names vertex {}, there are {}", name_, place, index, vertices);
      }
      order.push_back(static_cast<std::uint32_t>(index));
    }
  }
  const int mode = primitive.mode < 0 ? TINYGLTF_MODE_TRIANGLES : primitive.mode;
  std::vector<std::uint32_t> result;
  // Faces whose corners coincide stay in a list; in a strip they only lead on.
  const bool listed = mode == TINYGLTF_MODE_TRIANGLES;
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (listed || (a != b && b != c && c != a)) result.insert(result.end(), {a, b, c});
  };
  switch (mode) {
    case TINYGLTF_MODE_TRIANGLES:
      if (order.size() % 3 != 0) {
        return fail("{}: {}: has {} indices, not a multiple of 3", name_, what, order.size());
      }
      for (std::size_t i = 0; i + 2 < order.size(); i += 3) {
        add(order[i], order[i + 1], order[i + 2]);
      }
      break;
    case TINYGLTF_MODE_TRIANGLE_STRIP:
      for (std::size_t i = 0; i + 2 < order.size(); ++i) {
        const bool odd = i % 2 == 1;
        add(order[i], order[i + (odd ? 2 : 1)], order[i + (odd ? 1 : 2)]);
      }
      break;
    case TINYGLTF_MODE_TRIANGLE_FAN:
      for (std::size_t i = 1; i + 1 < order.size(); ++i) add(order[0], order[i], order[i + 1]);
      break;
    default:
      return fail("{}: {}/mode: {} draws points or lines; export triangles", name_, what, mode);
  }
  if (result.size() / 3 > limits_.max_triangles) {
    return fail("{}: {}: has {} triangles, more than the {} allowed", name_, what,
                result.size() / 3, limits_.max_triangles);
  }
  return result;
}

Result<TextureSampling> GltfReader::sampling(int index) const {
  TextureSampling result;
  if (index < 0) return result;
  if (!has(gltf_.samplers, index)) {
    return fail("{}: a texture names sampler {}, there are {}", name_, index,
                gltf_.samplers.size());
  }
  const tinygltf::Sampler& from = gltf_.samplers[static_cast<std::size_t>(index)];
  const auto unknown = [&](const char* field, int value) {
    return fail("{}: samplers/{}/{}: {} is none of glTF's values", name_, index, field, value);
  };
  const auto wrap = [](int value) -> std::optional<TextureWrap> {
    switch (value) {
      case TINYGLTF_TEXTURE_WRAP_REPEAT:
        return TextureWrap::repeat;
      case TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT:
        return TextureWrap::mirrored;
      case TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE:
        return TextureWrap::clamp;
      default:
        return std::nullopt;
    }
  };
  const auto s = wrap(from.wrapS);
  const auto t = wrap(from.wrapT);
  if (!s) return unknown("wrapS", from.wrapS);
  if (!t) return unknown("wrapT", from.wrapT);
  result.wrap_s = *s;
  result.wrap_t = *t;
  if (from.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST) {
    result.smooth_near = false;
  } else if (from.magFilter >= 0 && from.magFilter != TINYGLTF_TEXTURE_FILTER_LINEAR) {
    return unknown("magFilter", from.magFilter);
  }
  switch (from.minFilter) {
    case TINYGLTF_TEXTURE_FILTER_NEAREST:
    case TINYGLTF_TEXTURE_FILTER_LINEAR:
      result.mipmaps = TextureMipmaps::none;
      break;
    case TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_NEAREST:
    case TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_NEAREST:
      result.mipmaps = TextureMipmaps::nearest;
      break;
    case TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_LINEAR:
    case TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_LINEAR:
      break;
    default:
      if (from.minFilter >= 0) return unknown("minFilter", from.minFilter);
  }
  result.smooth_far = from.minFilter != TINYGLTF_TEXTURE_FILTER_NEAREST &&
                      from.minFilter != TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_NEAREST &&
                      from.minFilter != TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_LINEAR;
  return result;
}

template <class Info>
Result<MaterialTexture> GltfReader::texture(const Info& info, const std::string& what,
                                            std::vector<int>& texcoord_sets) {
  MaterialTexture result;
  if (info.index < 0) return result;
  if (info.extensions.contains("KHR_texture_transform")) {
    model_.warnings.push_back(
        fmt::format("{}: {}: its KHR_texture_transform is left out; apply it "
                    "to the texture coordinates",
                    name_, what));
  }
  const Result<int> picture = image(info.index, what);
  if (!picture) return tl::unexpected(picture.error());
  const Result<TextureSampling> sampled =
      sampling(gltf_.textures[static_cast<std::size_t>(info.index)].sampler);
  if (!sampled) return tl::unexpected(sampled.error());
  auto set = std::ranges::find(texcoord_sets, info.texCoord);
  if (set == texcoord_sets.end()) {
    if (texcoord_sets.size() == 2) {
      model_.warnings.push_back(
          fmt::format("{}: {}: is left out: it is the third of its material's "
                      "textures that are laid out in "
                      "different ways",
                      name_, what));
      return result;
    }
    texcoord_sets.push_back(info.texCoord);
    set = texcoord_sets.end() - 1;
  }
  result.image = *picture;
  result.texcoords = static_cast<int>(set - texcoord_sets.begin());
  result.sampling = *sampled;
  return result;
}

// The picture of a texture.
Result<int> GltfReader::image(int index, const std::string& what) {
  if (!has(gltf_.textures, index)) {
    return fail("{}: {}: names texture {}, there are {}", name_, what, index,
                gltf_.textures.size());
  }
  const int source = gltf_.textures[static_cast<std::size_t>(index)].source;
  if (!has(gltf_.images, source)) {
    return fail("{}: textures/{}: names image {}, there are {}", name_, index, source,
                gltf_.images.size());
  }
  const auto known = image_index_.find(source);
  if (known != image_index_.end()) return known->second;
  const tinygltf::Image& image = gltf_.images[static_cast<std::size_t>(source)];
  const std::string place = fmt::format("{}: images/{}", name_, source);
  std::span<const std::uint8_t> coded(image.image);
  if (image.bufferView >= 0) {
    const Result<std::span<const std::uint8_t>> view =
        view_bytes(image.bufferView, fmt::format("images/{}", source));
    if (!view) return tl::unexpected(view.error());
    coded = *view;
  }
  if (coded.empty()) {
    return fail("{}: {} can't be read; put it beside the model or embed it", place,
                image.uri.empty() ? "its data" : image.uri.substr(0, 80));
  }
  const Result<int> added = add_texture(model_, coded, place, limits_);
  if (added) image_index_.emplace(source, *added);
  return added;
}

Result<void> GltfReader::read_materials() {
  for (std::size_t i = 0; i < gltf_.materials.size(); ++i) {
    const tinygltf::Material& from = gltf_.materials[i];
    const tinygltf::PbrMetallicRoughness& pbr = from.pbrMetallicRoughness;
    const std::string what = fmt::format("materials/{}", i);
    const bool shaped = pbr.baseColorFactor.size() == 4 &&
                        (from.emissiveFactor.empty() || from.emissiveFactor.size() == 3);
    if (!shaped) return fail("{}: {}: a colour has the wrong number of components", name_, what);
    Material material;
    material.name = from.name.empty() ? what : from.name;
    for (int c = 0; c < 4; ++c) {
      material.base_color[c] = static_cast<float>(pbr.baseColorFactor[static_cast<std::size_t>(c)]);
    }
    if (from.alphaMode == "MASK") {
      material.alpha_mode = AlphaMode::mask;
      material.alpha_cutoff = static_cast<float>(from.alphaCutoff);
    } else if (from.alphaMode == "BLEND") {
      material.alpha_mode = AlphaMode::blend;
    } else if (from.alphaMode == "OPAQUE") {
      material.base_color.a = 1.0F;
    } else {
      return fail("{}: {}/alphaMode: \"{}\" is none of OPAQUE, MASK and BLEND", name_, what,
                  from.alphaMode.substr(0, 40));
    }
    for (int c = 0; c < 3 && !from.emissiveFactor.empty(); ++c) {
      material.emissive[c] = static_cast<float>(from.emissiveFactor[static_cast<std::size_t>(c)]);
    }
    material.metallic = static_cast<float>(pbr.metallicFactor);
    material.roughness = static_cast<float>(pbr.roughnessFactor);
    material.double_sided = from.doubleSided;
    material.normal_scale = static_cast<float>(from.normalTexture.scale);
    material.occlusion_strength = static_cast<float>(from.occlusionTexture.strength);
    std::vector<int>& sets = texcoord_sets_.emplace_back();
    std::optional<Error> failed;
    const auto take = [&](MaterialTexture& to, const auto& info, const char* which) {
      if (failed) return;
      Result<MaterialTexture> taken = texture(info, what + "/" + which, sets);
      if (taken) {
        to = *taken;
      } else {
        failed = taken.error();
      }
    };
    take(material.base_color_texture, pbr.baseColorTexture, "baseColorTexture");
    take(material.metallic_roughness_texture, pbr.metallicRoughnessTexture,
         "metallicRoughnessTexture");
    take(material.normal_texture, from.normalTexture, "normalTexture");
    take(material.occlusion_texture, from.occlusionTexture, "occlusionTexture");
    take(material.emissive_texture, from.emissiveTexture, "emissiveTexture");
    if (failed) return tl::unexpected(*failed);
    model_.materials.push_back(std::move(material));
  }
  // What a primitive without a material gets, by the specification 5.19; a metal with nothing to
  // mirror would be black, so it is a plain white body here.
  Material plain;
  plain.name = "default";
  model_.materials.push_back(plain);
  return {};
}

Result<Mesh> GltfReader::read_primitive(const tinygltf::Primitive& primitive,
                                        const std::string& what) {
  Mesh mesh;
  const Result<Elements> positions = attribute(primitive, "POSITION", 3, 3, 0, what);
  if (!positions) return tl::unexpected(positions.error());
  if (positions->count == 0) return fail("{}: {}: has no POSITION attribute", name_, what);
  if (positions->count > limits_.max_vertices) {
    return fail("{}: {}: has {} vertices, more than the {} allowed", name_, what, positions->count,
                limits_.max_vertices);
  }
  const std::size_t count = positions->count;
  const Result<Elements> normals = attribute(primitive, "NORMAL", 3, 3, count, what);
  if (!normals) return tl::unexpected(normals.error());
  const Result<Elements> colors = attribute(primitive, "COLOR_0", 3, 4, count, what);
  if (!colors) return tl::unexpected(colors.error());
  const Result<Elements> kernels = attribute(primitive, "_SHADOW_KERNEL", 3, 3, count, what);
  if (!kernels) return tl::unexpected(kernels.error());
  if (primitive.material >= static_cast<int>(gltf_.materials.size())) {
    return fail("{}: {}: names material {}, there are {}", name_, what, primitive.material,
                gltf_.materials.size());
  }
  mesh.material =
      primitive.material < 0 ? static_cast<int>(gltf_.materials.size()) : primitive.material;
  std::vector<int> sets;
  if (primitive.material >= 0) sets = texcoord_sets_[static_cast<std::size_t>(primitive.material)];
  if (sets.empty()) sets.push_back(0);
  const auto read_texcoords = [&](int set, std::vector<glm::vec2>& to) -> Result<void> {
    const Result<Elements> from =
        attribute(primitive, fmt::format("TEXCOORD_{}", set), 2, 2, count, what);
    if (!from) return tl::unexpected(from.error());
    for (std::size_t i = 0; i < from->count; ++i)
      to.emplace_back(static_cast<float>(from->at(i, 0)), static_cast<float>(from->at(i, 1)));
    return {};
  };
  if (auto done = read_texcoords(sets[0], mesh.texcoords); !done)
    return tl::unexpected(done.error());
  if (sets.size() > 1) {
    if (auto done = read_texcoords(sets[1], mesh.texcoords_2); !done)
      return tl::unexpected(done.error());
  }
  const bool bumpy =
      model_.materials[static_cast<std::size_t>(mesh.material)].normal_texture.image >= 0;
  const Result<Elements> tangents =
      bumpy ? attribute(primitive, "TANGENT", 4, 4, count, what) : Result<Elements>(Elements{});
  if (!tangents) return tl::unexpected(tangents.error());
  Result<std::vector<std::uint32_t>> indices = triangles(primitive, count, what);
  if (!indices) return tl::unexpected(indices.error());
  mesh.indices = std::move(*indices);
  const auto number = [](const Elements& from, std::size_t i, std::size_t c) {
    return static_cast<float>(from.at(i, c));
  };
  mesh.positions.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    mesh.positions.emplace_back(number(*positions, i, 0), number(*positions, i, 1),
                                number(*positions, i, 2));
    mesh.source_vertex.push_back(model_.source_vertex_count + static_cast<std::uint32_t>(i));
  }
  for (std::size_t i = 0; i < kernels->count; ++i) {
    mesh.shadow_kernels.emplace_back(number(*kernels, i, 0), number(*kernels, i, 1),
                                     number(*kernels, i, 2));
  }
  for (std::size_t i = 0; i < normals->count; ++i) {
    mesh.normals.emplace_back(number(*normals, i, 0), number(*normals, i, 1),
                              number(*normals, i, 2));
  }
  for (std::size_t i = 0; i < tangents->count; ++i) {
    mesh.tangents.emplace_back(number(*tangents, i, 0), number(*tangents, i, 1),
                               number(*tangents, i, 2), number(*tangents, i, 3));
  }
  for (std::size_t i = 0; i < colors->count; ++i) {
    mesh.colors.emplace_back(number(*colors, i, 0), number(*colors, i, 1), number(*colors, i, 2),
                             colors->width == 4 ? number(*colors, i, 3) : 1.0F);
  }
  return mesh;
}

Result<void> GltfReader::read_meshes() {
  std::size_t vertices = 0;
  for (std::size_t m = 0; m < gltf_.meshes.size(); ++m) {
    const tinygltf::Mesh& from = gltf_.meshes[m];
    std::vector<Mesh> primitives;
    for (std::size_t p = 0; p < from.primitives.size(); ++p) {
      Result<Mesh> mesh =
          read_primitive(from.primitives[p], fmt::format("meshes/{}/primitives/{}", m, p));
      if (!mesh) return tl::unexpected(mesh.error());
      vertices += mesh->positions.size();
      if (vertices > limits_.max_vertices) {
        return fail("{}: has more than the {} vertices allowed", name_, limits_.max_vertices);
      }
      model_.source_vertex_count = static_cast<std::uint32_t>(vertices);
      mesh->name = from.name;
      primitives.push_back(std::move(*mesh));
    }
    meshes_.push_back(std::move(primitives));
  }
  return {};
}

Result<Eigen::Matrix4d> GltfReader::node_matrix(const tinygltf::Node& node,
                                                const std::string& what) const {
  const auto shaped = [](const std::vector<double>& list, std::size_t size) {
    return (list.empty() || list.size() == size) &&
           std::all_of(list.begin(), list.end(), [](double x) { return std::isfinite(x); });
  };
  if (!shaped(node.matrix, 16) || !shaped(node.translation, 3) || !shaped(node.rotation, 4) ||
      !shaped(node.scale, 3)) {
    return fail("{}: {}: its transform has the wrong number of components", name_, what);
  }
  if (!node.matrix.empty()) {
    const Eigen::Matrix4d matrix = Eigen::Map<const Eigen::Matrix4d>(node.matrix.data());
    const Eigen::RowVector4d last = matrix.row(3);
    if ((last - Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0)).cwiseAbs().maxCoeff() > 1e-6) {
      return fail("{}: {}/matrix: is not a placement in space (last row 0 0 0 1)", name_, what);
    }
    return matrix;
  }
  Eigen::Affine3d placement = Eigen::Affine3d::Identity();
  if (!node.translation.empty()) {
    placement.translate(Eigen::Map<const Eigen::Vector3d>(node.translation.data()));
  }
  if (!node.rotation.empty()) {
    const Eigen::Quaterniond rotation(node.rotation[3], node.rotation[0], node.rotation[1],
                                      node.rotation[2]);
    if (!(std::abs(rotation.norm() - 1.0) < 0.1)) {
      return fail("{}: {}/rotation: is not a unit quaternion", name_, what);
    }
    placement.rotate(rotation.normalized());
  }
  if (!node.scale.empty()) {
    placement.scale(Eigen::Map<const Eigen::Vector3d>(node.scale.data()));
  }
  return placement.matrix();
}

// What a mesh says of its `_SHADOW_KERNEL` attribute. The direction is in the mesh's own axes, as
// the attribute is.
void GltfReader::take_kernel_extras(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                                    const std::string& what) {
  if (!extras.IsObject() || !extras.Has(std::string(kKernelUpKey))) return;
  const tinygltf::Value& up = extras.Get(std::string(kKernelUpKey));
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  bool usable = up.IsArray() && up.ArrayLen() == 3;
  for (int i = 0; usable && i < 3; ++i) {
    usable = up.Get(i).IsNumber();
    if (usable) direction[i] = up.Get(i).GetNumberAsDouble();
  }
  direction = (linear * direction).stableNormalized();
  if (!usable || !direction.allFinite() || !(direction.norm() > 0.5)) {
    model_.warnings.push_back(
        fmt::format("{}: {}: {} is no direction; its stored shadow kernels are not used", name_,
                    what, kKernelUpKey));
    return;
  }
  const glm::vec3 turned(static_cast<float>(direction.x()), static_cast<float>(direction.y()),
                         static_cast<float>(direction.z()));
  if (model_.shadow_kernel_up && glm::dot(turned, *model_.shadow_kernel_up) < 0.99999F) {
    model_.warnings.push_back(fmt::format(
        "{}: {}: its shadow kernels are for another direction than those of other meshes", name_,
        what));
    kernels_disagree_ = true;
  }
  model_.shadow_kernel_up = turned;
  if (extras.Has(std::string(kKernelGeometryKey)) &&
      extras.Get(std::string(kKernelGeometryKey)).IsString()) {
    model_.shadow_kernel_geometry = extras.Get(std::string(kKernelGeometryKey)).Get<std::string>();
  }
  if (!extras.Has(std::string(kKernelGroupsKey))) return;
  const tinygltf::Value& groups = extras.Get(std::string(kKernelGroupsKey));
  std::vector<std::string> names;
  for (std::size_t i = 0; groups.IsArray() && i < groups.ArrayLen(); ++i) {
    const tinygltf::Value& group = groups.Get(static_cast<int>(i));
    if (group.IsString()) names.push_back(group.Get<std::string>());
  }
  if (!groups.IsArray() || names.size() != groups.ArrayLen() || names.size() > kMaxGroups) {
    model_.warnings.push_back(fmt::format(
        "{}: {}: {} is no list of names; its parts are not joined", name_, what, kKernelGroupsKey));
    return;
  }
  model_.shadow_kernel_groups = std::move(names);
}

// Names of a node and of its mesh, -1 where it has none.
std::uint32_t GltfReader::add_node(const std::string& node, int mesh, int parent) {
  model_.nodes.push_back(
      {node, has(gltf_.meshes, mesh) ? gltf_.meshes[static_cast<std::size_t>(mesh)].name : "",
       parent});
  return static_cast<std::uint32_t>(model_.nodes.size() - 1);
}

Result<void> GltfReader::place_mesh(int index, const Eigen::Matrix4d& T_root_node,
                                    const std::string& what, std::uint32_t node) {
  if (!has(meshes_, index)) {
    return fail("{}: {}: names mesh {}, there are {}", name_, what, index, meshes_.size());
  }
  const Eigen::Matrix3d linear = T_root_node.topLeftCorner<3, 3>();
  const double determinant = linear.determinant();
  if (!T_root_node.allFinite() || !std::isfinite(determinant)) {
    return fail("{}: {}: its transform is not finite", name_, what);
  }
  // A mirroring turns triangles inside out: their winding is turned back. The normals follow the
  // cofactor matrix (det * inverse transposed), which also exists where the inverse does not.
  const bool mirrored = determinant < 0.0;
  Eigen::Matrix3d cofactor;
  cofactor << linear.col(1).cross(linear.col(2)), linear.col(2).cross(linear.col(0)),
      linear.col(0).cross(linear.col(1));
  if (mirrored) cofactor = -cofactor;
  const double cofactor_size = cofactor.cwiseAbs().maxCoeff();
  if (!(cofactor_size > 0.0)) {
    return fail(
        "{}: {}: its scale leaves no surface to see; give scales other than 0, or remove "
        "the node",
        name_, what);
  }
  cofactor /= cofactor_size;
  take_kernel_extras(gltf_.meshes[static_cast<std::size_t>(index)].extras, linear, what);
  for (const Mesh& from : meshes_[static_cast<std::size_t>(index)]) {
    placed_vertices_ += from.positions.size();
    placed_triangles_ += from.indices.size() / 3;
    if (placed_vertices_ > limits_.max_vertices || placed_triangles_ > limits_.max_triangles) {
      return fail("{}: {}: the model has more than the {} vertices or {} triangles allowed", name_,
                  what, limits_.max_vertices, limits_.max_triangles);
    }
    Mesh mesh = from;
    if (mesh.indices.empty()) continue;
    mesh.node_faces = {{node, 0, mesh.indices.size()}};
    for (glm::vec3& p : mesh.positions) {
      const Eigen::Vector4d placed = T_root_node * Eigen::Vector4d(p.x, p.y, p.z, 1.0);
      if (!(placed.head<3>().cwiseAbs().maxCoeff() <= limits_.max_coordinate_m)) {
        return fail("{}: {}: a vertex lies farther than {} m from the origin", name_, what,
                    limits_.max_coordinate_m);
      }
      p = {static_cast<float>(placed.x()), static_cast<float>(placed.y()),
           static_cast<float>(placed.z())};
    }
    for (glm::vec3& k : mesh.shadow_kernels) {
      const Eigen::Vector4d placed = T_root_node * Eigen::Vector4d(k.x, k.y, k.z, 1.0);
      k = {static_cast<float>(placed.x()), static_cast<float>(placed.y()),
           static_cast<float>(placed.z())};
    }
    if (mirrored) {
      for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
        std::swap(mesh.indices[i + 1], mesh.indices[i + 2]);
      }
    }
    if (mesh.normals.empty() || determinant == 0.0) {
      generate_normals(mesh);
      mesh.tangents.clear();  // they belong to the normals that are not there (glTF 2.0, 3.7.2.1)
    } else {
      for (glm::vec3& n : mesh.normals) {
        const Eigen::Vector3d turned =
            (cofactor * Eigen::Vector3d(n.x, n.y, n.z)).stableNormalized();
        n = {static_cast<float>(turned.x()), static_cast<float>(turned.y()),
             static_cast<float>(turned.z())};
      }
    }
    for (glm::vec4& t : mesh.tangents) {
      const Eigen::Vector3d turned = (linear * Eigen::Vector3d(t.x, t.y, t.z)).stableNormalized();
      t = {static_cast<float>(turned.x()), static_cast<float>(turned.y()),
           static_cast<float>(turned.z()), mirrored ? -t.w : t.w};
    }
    const Material& material = model_.materials[static_cast<std::size_t>(mesh.material)];
    if (material.normal_texture.image >= 0 && mesh.tangents.empty()) {
      const std::size_t before = mesh.positions.size();
      generate_tangents(mesh, material.normal_texture.texcoords == 1);
      placed_vertices_ += mesh.positions.size() - before;
    }
    const auto [entry, is_new] = mesh_of_material_.try_emplace(mesh.material, model_.meshes.size());
    if (is_new) {
      model_.meshes.push_back(std::move(mesh));
    } else {
      append_mesh(model_.meshes[entry->second], mesh);
    }
  }
  return {};
}

Result<void> GltfReader::place_node(int index, const Eigen::Matrix4d& T_root_parent, int depth,
                                    int parent) {
  const std::string what = fmt::format("nodes/{}", index);
  if (!has(gltf_.nodes, index)) {
    return fail("{}: {}: does not exist, there are {}", name_, what, gltf_.nodes.size());
  }
  if (depth > kMaxModelDepth) {
    return fail("{}: {}: is nested deeper than {} nodes", name_, what, kMaxModelDepth);
  }
  // glTF's nodes are trees: a node met twice is a cycle or has two parents.
  if (placed_[static_cast<std::size_t>(index)]) {
    return fail("{}: {}: hangs in the scene twice or inside itself", name_, what);
  }
  placed_[static_cast<std::size_t>(index)] = true;
  const tinygltf::Node& node = gltf_.nodes[static_cast<std::size_t>(index)];
  const Result<Eigen::Matrix4d> matrix = node_matrix(node, what);
  if (!matrix) return tl::unexpected(matrix.error());
  const Eigen::Matrix4d T_root_node = T_root_parent * *matrix;
  const std::uint32_t known = add_node(node.name, node.mesh, parent);
  if (node.mesh >= 0) {
    const Result<void> placed = place_mesh(
        node.mesh, T_root_node,
        node.name.empty() ? what : fmt::format("{} (\"{}\")", what, node.name.substr(0, 60)),
        known);
    if (!placed) return placed;
  }
  for (const int child : node.children) {
    const Result<void> placed = place_node(child, T_root_node, depth + 1, static_cast<int>(known));
    if (!placed) return placed;
  }
  return {};
}

Result<Model> GltfReader::read() {
  // Vertices quantised to integers need no special treatment; the rest would change the shape.
  for (const std::string& extension : gltf_.extensionsRequired) {
    if (extension != "KHR_mesh_quantization") {
      return fail("{}: needs the glTF extension {}, which can't be read; export without it", name_,
                  extension.substr(0, 80));
    }
  }
  model_.culls_back_faces = true;
  if (Result<void> done = read_materials(); !done) return tl::unexpected(done.error());
  if (Result<void> done = read_meshes(); !done) return tl::unexpected(done.error());
  placed_.assign(gltf_.nodes.size(), false);
  const Eigen::Matrix4d identity = Eigen::Matrix4d::Identity();
  if (!gltf_.scenes.empty()) {
    const int scene = std::max(gltf_.defaultScene, 0);
    if (!has(gltf_.scenes, scene)) {
      return fail("{}: scene: names scene {}, there are {}", name_, scene, gltf_.scenes.size());
    }
    for (const int node : gltf_.scenes[static_cast<std::size_t>(scene)].nodes) {
      if (Result<void> done = place_node(node, identity, 1); !done) {
        return tl::unexpected(done.error());
      }
    }
    if (kernels_disagree_) model_.shadow_kernel_up.reset();
    return std::move(model_);
  }
  // A file without scenes is a library: everything in it is taken.
  std::vector<bool> is_child(gltf_.nodes.size(), false);
  for (const tinygltf::Node& node : gltf_.nodes) {
    for (const int child : node.children) {
      if (has(gltf_.nodes, child)) is_child[static_cast<std::size_t>(child)] = true;
    }
  }
  for (std::size_t node = 0; node < gltf_.nodes.size(); ++node) {
    if (is_child[node]) continue;
    if (Result<void> done = place_node(static_cast<int>(node), identity, 1); !done) {
      return tl::unexpected(done.error());
    }
  }
  if (gltf_.nodes.empty()) {
    for (std::size_t mesh = 0; mesh < meshes_.size(); ++mesh) {
      const auto index = static_cast<int>(mesh);
      Result<void> done =
          place_mesh(index, identity, fmt::format("meshes/{}", mesh), add_node("", index, -1));
      if (!done) return tl::unexpected(done.error());
    }
  }
  if (kernels_disagree_) model_.shadow_kernel_up.reset();
  return std::move(model_);
}

// One line of a library's report.
std::string first_line(const std::string& text) {
  const std::string line = text.substr(0, text.find('\n'));
  return line.empty() ? "malformed" : line.substr(0, 200);
}

}  // namespace

Result<Model> read_gltf(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                        bool binary, const ModelLimits& limits) {
  const std::string name = file.string();
  std::string_view json(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (binary) {
    const Result<std::string_view> chunk = json_chunk(name, bytes);
    if (!chunk) return tl::unexpected(chunk.error());
    json = *chunk;
  }
  if (nesting_depth(json) > kMaxModelDepth) {
    return fail("{}: its JSON is nested deeper than {} levels", name, kMaxModelDepth);
  }
  Neighbours neighbours{file.parent_path(), limits.max_file_bytes, {}};
  tinygltf::TinyGLTF reader;
  reader.SetFsCallbacks({neighbour_exists, same_path, read_neighbour, write_nothing, &neighbours});
  reader.SetImageLoader(keep_picture, nullptr);
  tinygltf::Model gltf;
  std::string error, warning;
  const std::string folder(kModelFolder);
  const auto size = static_cast<unsigned int>(bytes.size());
  const bool read =
      binary
          ? reader.LoadBinaryFromMemory(&gltf, &error, &warning, bytes.data(), size, folder)
          : reader.LoadASCIIFromString(&gltf, &error, &warning,
                                       reinterpret_cast<const char*>(bytes.data()), size, folder);
  if (!read && !neighbours.refused.empty()) return fail("{}: {}", name, neighbours.refused);
  if (!read) return fail("{}: is not glTF 2.0: {}", name, first_line(error));
  if (!neighbours.refused.empty()) return fail("{}: {}", name, neighbours.refused);
  if (!gltf.asset.version.starts_with("2.") && gltf.asset.version != "2") {
    return fail("{}: asset: version is '{}'; only glTF 2.0 is read, export it as that", name,
                gltf.asset.version.substr(0, 20));
  }
  Result<Model> model = GltfReader(name, gltf, limits).read();
  if (model && !model->shadow_kernel_up) {
    for (Mesh& mesh : model->meshes)
      mesh.shadow_kernels.clear();  // nobody knows for which direction
  }
  return model;
}

}  // namespace penumbra
