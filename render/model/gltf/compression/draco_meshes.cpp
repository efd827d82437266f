#include "render/model/gltf/compression/draco_meshes.hpp"

#include <draco/compression/decode.h>
#include <draco/compression/point_cloud/point_cloud_decoder.h>
#include <draco/core/varint_decoding.h>
#include <draco/metadata/metadata_decoder.h>

#include <algorithm>
#include <exception>
#include <new>

#include "core/propagate.hpp"
#include "render/model/gltf/document.hpp"
#include "render/model/gltf/extensions.hpp"

namespace penumbra::gltf {
namespace {

// Counts that the accessors of a primitive declare.
struct DeclaredCounts {
  std::size_t points = 0;
  std::size_t max_faces = 0;
};

tl::unexpected<Error> fail_damaged(const std::string& json_path, const std::string& cause) {
  const std::string line = cause.substr(0, cause.find('\n')).substr(0, 100);
  return fail("{}: its data is damaged{}{}; copy or export the model again", json_path,
              line.empty() ? "" : ": ", line);
}

// Checks the counts at the start of the data, before the decoder reserves memory for them.
Result<void> check_start(std::span<const std::uint8_t> coded, const DeclaredCounts& declared,
                         const std::string& json_path) {
  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char*>(coded.data()), coded.size());
  draco::DracoHeader header{};
  if (!draco::PointCloudDecoder::DecodeHeader(&buffer, &header).ok()) {
    return fail_damaged(json_path, "it does not start with \"DRACO\"");
  }
  if (header.encoder_type != draco::TRIANGULAR_MESH) {
    return fail("{}: has no triangles; export the model again", json_path);
  }
  if (header.version_major != 2 || header.version_minor != 2) {
    return fail("{}: is in version {}.{} of the format; export it in version 2.2", json_path,
                header.version_major, header.version_minor);
  }
  buffer.set_bitstream_version(DRACO_BITSTREAM_VERSION(2, 2));
  draco::GeometryMetadata metadata;
  if ((header.flags & METADATA_FLAG_MASK) != 0 &&
      !draco::MetadataDecoder().DecodeGeometryMetadata(&buffer, &metadata)) {
    return fail_damaged(json_path, "its metadata");
  }
  std::uint32_t faces = 0, vertices = 0;
  bool complete = false;
  if (header.encoder_method == draco::MESH_EDGEBREAKER_ENCODING) {
    std::uint8_t traversal = 0;
    complete = buffer.Decode(&traversal) && draco::DecodeVarint(&vertices, &buffer) &&
               draco::DecodeVarint(&faces, &buffer);
  } else {
    complete = draco::DecodeVarint(&faces, &buffer) && draco::DecodeVarint(&vertices, &buffer);
  }
  if (!complete) return fail_damaged(json_path, "it is cut short");
  if (faces > declared.max_faces || vertices > declared.points) {
    return fail(
        "{}: has {} triangles and {} vertices, more than its accessors ({} and {}); export the "
        "model again",
        json_path, faces, vertices, declared.max_faces, declared.points);
  }
  return {};
}

// Returns glTF's type of a component, or 0.
int component_type_of(draco::DataType type) {
  switch (type) {
    case draco::DT_INT8:
      return TINYGLTF_COMPONENT_TYPE_BYTE;
    case draco::DT_UINT8:
      return TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE;
    case draco::DT_INT16:
      return TINYGLTF_COMPONENT_TYPE_SHORT;
    case draco::DT_UINT16:
      return TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT;
    case draco::DT_UINT32:
      return TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
    case draco::DT_FLOAT32:
      return TINYGLTF_COMPONENT_TYPE_FLOAT;
    default:
      return 0;
  }
}

// Returns the primitive's accessor of a key, or nullptr.
const tinygltf::Accessor* accessor_of(const Accessors& accessors,
                                      const tinygltf::Primitive& primitive,
                                      const std::string& key) {
  const auto entry = primitive.attributes.find(key);
  return entry == primitive.attributes.end() ? nullptr : accessors.find(entry->second);
}

// Returns the identifier of an attribute in the compressed data, or -1.
int identifier_of(const tinygltf::Primitive& primitive, const std::string& key) {
  const auto extension = primitive.extensions.find(kDraco);
  if (extension == primitive.extensions.end() || !extension->second.Has("attributes")) return -1;
  const tinygltf::Value& attributes = extension->second.Get("attributes");
  return attributes.Has(key) ? attributes.Get(key).GetNumberAsInt() : -1;
}

std::string extension_path(const std::string& what) {
  return fmt::format("{}/extensions/{}", what, kDraco);
}

}  // namespace

bool DracoMeshes::is_used(const tinygltf::Primitive& primitive) const {
  if (!primitive.extensions.contains(kDraco)) return false;
  return std::ranges::any_of(primitive.attributes, [&](const auto& attribute) {
    if (attribute.first != kIndicesKey && identifier_of(primitive, attribute.first) < 0)
      return false;
    const tinygltf::Accessor* accessor = accessors_.find(attribute.second);
    return accessor != nullptr && accessor->bufferView < 0 && !accessor->sparse.isSparse;
  });
}

bool DracoMeshes::has(const tinygltf::Primitive& primitive, const std::string& key) const {
  return is_used(primitive) && (key == kIndicesKey || identifier_of(primitive, key) >= 0);
}

Result<const draco::Mesh*> DracoMeshes::decoded(const tinygltf::Primitive& primitive,
                                                const std::string& what) {
  const std::string json_path = extension_path(what);
  const tinygltf::Value& extension = primitive.extensions.at(kDraco);
  if (!extension.Has("bufferView")) {
    return fail("{}: has no bufferView; export the model again", json_path);
  }
  const int view = extension.Get("bufferView").GetNumberAsInt();
  const tinygltf::Accessor* positions = accessor_of(accessors_, primitive, "POSITION");
  if (positions == nullptr) return fail("{}/attributes/POSITION: has no accessor", what);
  const tinygltf::Accessor* indices = accessor_of(accessors_, primitive, kIndicesKey);
  DeclaredCounts declared{positions->count, limits_.max_triangles};
  if (declared.points > limits_.max_vertices) {
    return fail("{}: has {} vertices, more than the {} allowed", what, declared.points,
                limits_.max_vertices);
  }
  if (indices != nullptr) declared.max_faces = std::min(declared.max_faces, indices->count);
  const bool is_list = primitive.mode < 0 || primitive.mode == TINYGLTF_MODE_TRIANGLES;
  if (indices != nullptr && is_list) {
    declared.max_faces = std::min(limits_.max_triangles, indices->count / 3);
  }
  std::shared_ptr<const draco::Mesh>& known = meshes_[view];
  if (!known) {
    PENUMBRA_TRY(const auto coded, accessors_.view_bytes(view, json_path + "/bufferView"));
    PENUMBRA_TRY_VOID(check_start(coded, declared, json_path));
    draco::DecoderBuffer buffer;
    buffer.Init(reinterpret_cast<const char*>(coded.data()), coded.size());
    try {
      auto read = draco::Decoder().DecodeMeshFromBuffer(&buffer);
      if (!read.ok()) return fail_damaged(json_path, read.status().error_msg_string());
      known = std::move(read).value();
    } catch (const std::bad_alloc&) {
      throw;  // load_model() reports it
    } catch (const std::exception& error) {
      return fail_damaged(json_path, error.what());
    }
  }
  if (known->num_points() != declared.points) {
    return fail("{}: has {} vertices, its accessors {}; export the model again", json_path,
                known->num_points(), declared.points);
  }
  const bool agrees = !is_list || indices == nullptr || indices->count == 3UL * known->num_faces();
  if (!agrees || known->num_faces() > declared.max_faces) {
    return fail("{}: has {} triangles, its accessor {} indices; export the model again", json_path,
                known->num_faces(), indices == nullptr ? 0 : indices->count);
  }
  return known.get();
}

Result<Elements> DracoMeshes::attribute(const tinygltf::Primitive& primitive,
                                        const std::string& key, const Shape& shape,
                                        const std::string& what) {
  const std::string json_path = fmt::format("{}/attributes/{}", extension_path(what), key);
  const auto entry = primitive.attributes.find(key);
  if (entry == primitive.attributes.end()) return Elements{};  // only the compressed data has it
  const tinygltf::Accessor* accessor = accessors_.find(entry->second);
  if (accessor == nullptr) {
    return fail("{}/attributes/{}: names accessor {}, which does not exist; export the model again",
                what, key, entry->second);
  }
  PENUMBRA_TRY(const draco::Mesh* mesh, decoded(primitive, what));
  const int identifier = identifier_of(primitive, key);
  const draco::PointAttribute* from =
      mesh->GetAttributeByUniqueId(static_cast<std::uint32_t>(identifier));
  if (from == nullptr) {
    return fail("{}: is {}, which its data does not have; export the model again", json_path,
                identifier);
  }
  const int type = component_type_of(from->data_type());
  Elements result{mesh->num_points(), static_cast<std::size_t>(from->num_components()), {}};
  if (type == 0 || result.width != component_count(accessor->type) ||
      accessor->count != result.count) {
    return fail("{}: differs from its accessor in type, components or count; export again",
                json_path);
  }
  const std::size_t size = component_size(type);
  const auto stride = static_cast<std::size_t>(from->byte_stride());
  const auto offset = static_cast<std::size_t>(from->byte_offset());
  const std::size_t bytes = from->buffer()->data_size();
  result.values.resize(result.count * result.width);
  for (std::uint32_t i = 0; i < result.count; ++i) {
    const std::size_t at = offset + stride * from->mapped_index(draco::PointIndex(i)).value();
    if (at > bytes || size * result.width > bytes - at) return fail_damaged(json_path, "");
    const std::uint8_t* element = from->buffer()->data() + at;
    for (std::size_t c = 0; c < result.width; ++c) {
      result.values[i * result.width + c] =
          component_at(element + c * size, type, accessor->normalized);
    }
  }
  return checked_elements(std::move(result), shape, json_path);
}

Result<std::vector<std::uint32_t>> DracoMeshes::corners(const tinygltf::Primitive& primitive,
                                                        const std::string& what) {
  PENUMBRA_TRY(const draco::Mesh* mesh, decoded(primitive, what));
  std::vector<std::uint32_t> corners;
  corners.reserve(3UL * mesh->num_faces());
  for (std::uint32_t i = 0; i < mesh->num_faces(); ++i) {
    for (const draco::PointIndex& point : mesh->face(draco::FaceIndex(i))) {
      if (point.value() >= mesh->num_points()) {
        return fail_damaged(extension_path(what), "a triangle names a vertex that does not exist");
      }
      corners.push_back(point.value());
    }
  }
  return corners;
}

}  // namespace penumbra::gltf
