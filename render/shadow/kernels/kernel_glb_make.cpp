// Converts a model of another format to a .glb.
#include <algorithm>
#include <glm/common.hpp>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "core/image/image_file.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/model_parts.hpp"
#include "render/shadow/kernels/glb_document.hpp"
#include "render/shadow/kernels/kernel_glb.hpp"

namespace penumbra {
namespace {

using Json = GlbDocument::Json;

constexpr int kRepeat = 10497;
constexpr int kMirroredRepeat = 33648;
constexpr int kClampToEdge = 33071;

std::size_t add_vertices(GlbDocument& document, const Mesh& mesh) {
  std::vector<glm::vec3> points;
  glm::vec3 low(std::numeric_limits<float>::max());
  glm::vec3 high(std::numeric_limits<float>::lowest());
  for (const glm::vec3& position : mesh.positions) {
    const glm::vec3& point = points.emplace_back(to_file_axes(position));
    low = glm::min(low, point);
    high = glm::max(high, point);
  }
  const std::size_t accessor = document.add_vectors(points);
  document.json.at("accessors").at(accessor)["min"] = {low.x, low.y, low.z};
  document.json.at("accessors").at(accessor)["max"] = {high.x, high.y, high.z};
  return accessor;
}

// The faces of a mesh that belong to one node. No vertex is shared with another node.
struct NamedMesh {
  Mesh mesh;
  std::optional<std::uint32_t> node;  // index into Model::nodes
};

constexpr std::uint32_t kNoVertex = std::numeric_limits<std::uint32_t>::max();

// Returns a node's faces. `new_index`: scratch memory, kNoVertex per vertex before and afterwards.
Mesh faces_of(const Mesh& mesh, const NodeFaces& run, std::vector<std::uint32_t>& new_index) {
  Mesh node_mesh;
  node_mesh.name = mesh.name;
  node_mesh.material = mesh.material;
  const auto copy = [](auto& to, const auto& from, std::uint32_t vertex) {
    if (!from.empty()) to.push_back(from[vertex]);
  };
  for (std::size_t i = 0; i < run.index_count; ++i) {
    const std::uint32_t vertex = mesh.indices[run.first_index + i];
    std::uint32_t& index = new_index[vertex];
    if (index == kNoVertex) {
      index = static_cast<std::uint32_t>(node_mesh.positions.size());
      copy(node_mesh.positions, mesh.positions, vertex);
      copy(node_mesh.normals, mesh.normals, vertex);
      copy(node_mesh.texcoords, mesh.texcoords, vertex);
      copy(node_mesh.colors, mesh.colors, vertex);
      copy(node_mesh.source_vertex, mesh.source_vertex, vertex);
    }
    node_mesh.indices.push_back(index);
  }
  for (std::size_t i = 0; i < run.index_count; ++i)
    new_index[mesh.indices[run.first_index + i]] = kNoVertex;
  return node_mesh;
}

// Splits meshes by node, in order, because groups of parts refer to nodes by name.
std::vector<NamedMesh> split_by_node(const Model& model) {
  std::vector<NamedMesh> pieces;
  for (const Mesh& mesh : model.meshes) {
    std::size_t named = 0;
    for (const NodeFaces& run : mesh.node_faces) named += run.index_count;
    if (named != mesh.indices.size()) {
      pieces.push_back({mesh, std::nullopt});
      continue;
    }
    std::vector<std::uint32_t> new_index(mesh.positions.size(), kNoVertex);
    for (const NodeFaces& run : mesh.node_faces) {
      if (run.index_count > 0) pieces.push_back({faces_of(mesh, run, new_index), run.node});
    }
  }
  return pieces;
}

// Returns the stamp for the model as written, in which a vertex shared by two nodes is duplicated.
std::string stamp_of(const std::vector<NamedMesh>& pieces, const std::string& stamp) {
  Model written;
  for (const NamedMesh& piece : pieces) {
    const auto same = std::ranges::find(written.meshes, piece.mesh.material, &Mesh::material);
    if (same == written.meshes.end()) {
      written.meshes.push_back(piece.mesh);
    } else {
      append_mesh(*same, piece.mesh);
    }
  }
  const std::size_t suffix = stamp.find('-');
  return geometry_key(written) + (suffix == std::string::npos ? "" : stamp.substr(suffix));
}

// Adds a node for the most recently written mesh, below nodes with the names of its ancestors.
void add_named_node(Json& json, const Model& model, const NamedMesh& piece) {
  json["nodes"].push_back({{"mesh", json["meshes"].size() - 1}});
  std::size_t top = json["nodes"].size() - 1;
  if (!piece.node) {
    json["nodes"][top]["name"] = as_utf8(piece.mesh.name);
  } else {
    json["nodes"][top]["name"] = as_utf8(model.nodes[*piece.node].name);
    int parent = model.nodes[*piece.node].parent;
    while (parent >= 0) {
      const auto& node = model.nodes[static_cast<std::size_t>(parent)];
      json["nodes"].push_back({{"name", as_utf8(node.name)}, {"children", Json::array({top})}});
      top = json["nodes"].size() - 1;
      parent = node.parent;
    }
  }
  if (!model.origin.isZero(0.0)) {
    const Eigen::Vector3d origin = to_file_axes(model.origin);
    json["nodes"][top]["translation"] = {origin.x(), origin.y(), origin.z()};
  }
  json["scenes"][0]["nodes"].push_back(top);
}

int wrap_mode(TextureWrap wrap) {
  if (wrap == TextureWrap::mirrored) return kMirroredRepeat;
  return wrap == TextureWrap::clamp ? kClampToEdge : kRepeat;
}

// Returns true if the texture's image file is in a glTF format and decodes to the same pixels.
bool has_embeddable_image(const Texture& texture) {
  if (media_type_of(texture.encoded).empty()) return false;
  const auto decoded = decode_rgba(texture.encoded, "");
  return decoded && decoded->pixels == texture.rgba;
}

class MaterialWriter {
 public:
  explicit MaterialWriter(GlbDocument& document) : document_(document) {}

  // Returns the number of images that can't be embedded.
  std::size_t add_images(const Model& model) {
    std::size_t skipped = 0;
    for (const auto& texture : model.textures) {
      if (!has_embeddable_image(*texture)) {
        ++skipped;
        images_.push_back(-1);
        continue;
      }
      const std::size_t view = document_.add_view(texture->encoded);
      Json& images = document_.json["images"];
      images.push_back({{"bufferView", view}, {"mimeType", media_type_of(texture->encoded)}});
      images_.push_back(static_cast<int>(images.size()) - 1);
    }
    return skipped;
  }

  void add(const Material& from) {
    const glm::vec4& c = from.base_color;
    Json material = {{"name", as_utf8(from.name)},
                     {"pbrMetallicRoughness",
                      {{"baseColorFactor", {c.r, c.g, c.b, c.a}},
                       {"metallicFactor", from.metallic},
                       {"roughnessFactor", from.roughness}}},
                     {"emissiveFactor", {from.emissive.r, from.emissive.g, from.emissive.b}}};
    material["doubleSided"] = from.double_sided;
    if (from.alpha_mode == AlphaMode::mask) {
      material["alphaMode"] = "MASK";
      material["alphaCutoff"] = from.alpha_cutoff;
    } else if (from.alpha_mode == AlphaMode::blend || c.a < 1.0F) {
      material["alphaMode"] = "BLEND";
    }
    Json& base = material["pbrMetallicRoughness"];
    add_texture(base, "baseColorTexture", from.base_color_texture);
    add_texture(base, "metallicRoughnessTexture", from.metallic_roughness_texture);
    add_texture(material, "normalTexture", from.normal_texture);
    if (material.contains("normalTexture")) material["normalTexture"]["scale"] = from.normal_scale;
    add_texture(material, "occlusionTexture", from.occlusion_texture);
    if (material.contains("occlusionTexture")) {
      material["occlusionTexture"]["strength"] = from.occlusion_strength;
    }
    add_texture(material, "emissiveTexture", from.emissive_texture);
    document_.json["materials"].push_back(std::move(material));
  }

 private:
  void add_texture(Json& to, const char* key, const MaterialTexture& texture) {
    if (texture.image < 0 || images_.at(static_cast<std::size_t>(texture.image)) < 0) return;
    Json& json = document_.json;
    json["samplers"].push_back({{"wrapS", wrap_mode(texture.sampling.wrap_s)},
                                {"wrapT", wrap_mode(texture.sampling.wrap_t)}});
    json["textures"].push_back({{"sampler", json["samplers"].size() - 1},
                                {"source", images_[static_cast<std::size_t>(texture.image)]}});
    to[key] = {{"index", json["textures"].size() - 1}};
  }

  GlbDocument& document_;
  std::vector<int> images_;  // image index per texture of the model; -1: not written
};

Json add_attributes(GlbDocument& document, const Mesh& mesh, const KernelFile& kernels) {
  Json attributes;
  attributes["POSITION"] = add_vertices(document, mesh);
  std::vector<glm::vec3> vectors;
  for (const glm::vec3& n : mesh.normals) vectors.push_back(to_file_axes(n));
  attributes["NORMAL"] = document.add_vectors(vectors);
  if (!mesh.colors.empty()) {
    attributes["COLOR_0"] =
        document.add(mesh.colors, GlbDocument::kFloat, "VEC4", GlbDocument::kArrayBuffer);
  }
  if (!mesh.texcoords.empty()) {
    attributes["TEXCOORD_0"] =
        document.add(mesh.texcoords, GlbDocument::kFloat, "VEC2", GlbDocument::kArrayBuffer);
  }
  vectors.clear();
  for (const std::uint32_t source : mesh.source_vertex) {
    vectors.push_back(to_file_axes(kernels.kernels.at(source)));
  }
  attributes["_SHADOW_KERNEL"] = document.add_vectors(vectors);
  return attributes;
}

Result<KernelGlb> make_document(const Model& model, KernelFile kernels) {
  GlbDocument document;
  Json& json = document.json;
  json["asset"] = {{"version", "2.0"}, {"generator", "penumbra kernels"}};
  json["scene"] = 0;
  json["scenes"] = Json::array({{{"nodes", Json::array()}}});
  KernelGlb result;
  MaterialWriter materials(document);
  if (const std::size_t skipped = materials.add_images(model); skipped > 0) {
    result.warnings.push_back(fmt::format(
        "{}: {} of its images can't be written into the .glb; their materials are plain there",
        model.name, skipped));
  }
  for (const Material& material : model.materials) materials.add(material);
  const std::vector<NamedMesh> pieces = split_by_node(model);
  // For a model far from the origin, load_model() chooses another origin and rounds differently,
  // so the stamp would not match.
  const bool is_far = !model.origin.isZero(0.0);
  kernels.geometry = is_far ? "" : stamp_of(pieces, kernels.geometry);
  for (const NamedMesh& piece : pieces) {
    const Mesh& from = piece.mesh;
    Json attributes = add_attributes(document, from, kernels);
    const std::size_t indices = document.add(from.indices, GlbDocument::kUnsignedInt, "SCALAR",
                                             GlbDocument::kElementArrayBuffer);
    Json primitive = {{"attributes", std::move(attributes)}, {"indices", indices}};
    primitive["material"] = from.material;
    const bool has_name = piece.node && !model.nodes[*piece.node].mesh.empty();
    Json mesh = {{"name", as_utf8(has_name ? model.nodes[*piece.node].mesh : from.name)},
                 {"primitives", Json::array({std::move(primitive)})}};
    write_extras(mesh, kernels, to_file_axes(kernels.up));
    json["meshes"].push_back(std::move(mesh));
    add_named_node(json, model, piece);
  }
  PENUMBRA_TRY(result.bytes, document.finish());
  return result;
}

}  // namespace

Result<KernelGlb> make_glb_with_kernels(const Model& model, const KernelFile& kernels) {
  try {
    return make_document(model, kernels);
  } catch (const std::exception& error) {
    return fail("{}: can't be written as glTF: {}", model.name, error.what());
  }
}

}  // namespace penumbra
