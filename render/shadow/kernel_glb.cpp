#include "render/shadow/kernel_glb.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "render/model_parts.hpp"
#include "render/to_eigen.hpp"

namespace penumbra {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::uint32_t kMagic = 0x46546C67;
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;
constexpr std::uint32_t kBinaryChunk = 0x004E4942;
constexpr int kArrayBuffer = 34962;
constexpr int kElementArrayBuffer = 34963;
constexpr int kFloat = 5126;
constexpr int kUnsignedInt = 5125;

std::uint32_t word_at(std::span<const std::uint8_t> bytes, std::size_t offset) {
  std::uint32_t word = 0;  // glTF is little-endian, like every machine this runs on
  std::memcpy(&word, bytes.data() + offset, 4);
  return word;
}

// The object frame is z up, the file y up.
Eigen::Vector3d to_file_axes(const Eigen::Vector3d& p) {
  return {p.x(), p.z(), -p.y()};
}
glm::vec3 to_file_axes(const glm::vec3& p) {
  return {p.x, p.z, p.y == 0.0F ? 0.0F : -p.y};
}

// Appends accessors with views of their own to a file's JSON and binary chunk.
class BinaryWriter {
 public:
  BinaryWriter(Json& json, std::vector<std::uint8_t> binary)
      : json_(json), binary_(std::move(binary)) {}

  template <class T>
  std::size_t add(std::span<const T> data, int component, const char* type, std::size_t count,
                  int target) {
    while (binary_.size() % 4 != 0) binary_.push_back(0);
    const std::size_t offset = binary_.size();
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(data.data());
    binary_.insert(binary_.end(), bytes, bytes + data.size_bytes());
    Json view = {{"buffer", 0}, {"byteOffset", offset}, {"byteLength", data.size_bytes()}};
    view["target"] = target;
    json_["bufferViews"].push_back(std::move(view));
    json_["accessors"].push_back({{"bufferView", json_["bufferViews"].size() - 1},
                                  {"componentType", component},
                                  {"count", count},
                                  {"type", type}});
    return json_["accessors"].size() - 1;
  }
  std::size_t add_vectors(std::span<const glm::vec3> vectors) {
    return add(vectors, kFloat, "VEC3", vectors.size(), kArrayBuffer);
  }

  [[nodiscard]] bool overwrite(std::size_t offset, std::span<const glm::vec3> vectors) {
    if (offset > binary_.size() || vectors.size_bytes() > binary_.size() - offset) return false;
    std::memcpy(binary_.data() + offset, vectors.data(), vectors.size_bytes());
    return true;
  }

  // The whole file.
  [[nodiscard]] Result<std::vector<std::uint8_t>> finish() {
    while (binary_.size() % 4 != 0) binary_.push_back(0);
    Json& buffers = json_["buffers"];
    if (!buffers.is_array() || buffers.empty()) buffers = Json::array({Json::object()});
    buffers[0]["byteLength"] = binary_.size();
    std::string text = json_.dump();
    while (text.size() % 4 != 0) text += ' ';
    const std::size_t length = 12 + 8 + text.size() + 8 + binary_.size();
    if (length > std::numeric_limits<std::uint32_t>::max()) {
      return fail("the .glb would be over 4 GB; store the kernels in a .json file");
    }
    std::vector<std::uint8_t> file;
    file.reserve(length);
    const auto word = [&file](std::size_t value) {
      for (unsigned shift = 0; shift < 32; shift += 8) {
        file.push_back(static_cast<std::uint8_t>(value >> shift));
      }
    };
    word(kMagic);
    word(2);
    word(length);
    word(text.size());
    word(kJsonChunk);
    file.insert(file.end(), text.begin(), text.end());
    word(binary_.size());
    word(kBinaryChunk);
    file.insert(file.end(), binary_.begin(), binary_.end());
    return file;
  }

 private:
  Json& json_;
  std::vector<std::uint8_t> binary_;
};

// How often accessors and views are read, by whatever: what only old kernels are in may be written
// over.
struct Readers {
  std::map<std::size_t, int> of_accessor, of_view;
};
Readers readers_of(const Json& json) {
  Readers readers;
  const auto count = [&readers](const Json& accessor) {
    if (accessor.is_number_unsigned()) ++readers.of_accessor[accessor.get<std::size_t>()];
  };
  for (const Json& mesh : json.at("meshes")) {
    for (const Json& primitive : mesh.at("primitives")) {
      for (const auto& [name, accessor] : primitive.at("attributes").items()) count(accessor);
      if (primitive.contains("indices")) count(primitive.at("indices"));
      if (!primitive.contains("targets")) continue;
      for (const Json& target : primitive.at("targets")) {
        for (const auto& [name, accessor] : target.items()) count(accessor);
      }
    }
  }
  const Json none = Json::array();
  const auto list = [&none](const Json& from, const char* name) -> const Json& {
    return from.contains(name) ? from.at(name) : none;
  };
  for (const Json& skin : list(json, "skins")) count(skin.value("inverseBindMatrices", Json()));
  for (const Json& animation : list(json, "animations")) {
    for (const Json& sampler : list(animation, "samplers")) {
      count(sampler.value("input", Json()));
      count(sampler.value("output", Json()));
    }
  }
  const auto count_view = [&readers](const Json& from) {
    if (from.contains("bufferView")) ++readers.of_view[from.at("bufferView").get<std::size_t>()];
  };
  for (const Json& accessor : json.at("accessors")) {
    count_view(accessor);
    if (!accessor.contains("sparse")) continue;
    for (const char* part : {"indices", "values"}) count_view(accessor.at("sparse").at(part));
  }
  for (const Json& image : list(json, "images")) count_view(image);
  return readers;
}

// Kernels that are there already, of as many vertices, one behind the other and read by nothing
// else (tools that join equal data let a position and a kernel share it), give their place to the
// new ones: a file that is stored again and again does not grow.
bool replace_vectors(const Json& json, const Readers& readers, BinaryWriter& writer,
                     const Json& attributes, std::span<const glm::vec3> vectors) {
  const auto there = attributes.find("_SHADOW_KERNEL");
  if (there == attributes.end()) return false;
  const auto index = there->get<std::size_t>();
  const Json& accessor = json.at("accessors").at(index);
  if (readers.of_accessor.at(index) != 1 || accessor.value("componentType", 0) != kFloat ||
      accessor.value("type", "") != "VEC3" ||
      accessor.value("count", std::size_t{0}) != vectors.size() || accessor.contains("sparse") ||
      !accessor.contains("bufferView")) {
    return false;
  }
  const auto view_index = accessor.at("bufferView").get<std::size_t>();
  const Json& view = json.at("bufferViews").at(view_index);
  const bool dense = !view.contains("byteStride") || view.at("byteStride") == sizeof(glm::vec3);
  const bool own = readers.of_view.at(view_index) == 1 &&
                   view.value("byteLength", std::size_t{0}) == vectors.size_bytes() &&
                   accessor.value("byteOffset", std::size_t{0}) == 0;
  if (!dense || !own || view.value("buffer", 0) != 0) return false;
  return writer.overwrite(view.value("byteOffset", std::size_t{0}), vectors);
}

void note_kernels(Json& mesh, const Eigen::Vector3d& up, const std::string& geometry,
                  const std::vector<std::string>& groups) {
  Json& extras = mesh["extras"];
  if (!extras.is_object()) extras = Json::object();
  extras[std::string(kKernelUpKey)] = {up.x(), up.y(), up.z()};
  extras[std::string(kKernelGeometryKey)] = geometry;
  extras.erase(std::string(kKernelGroupsKey));
  if (!groups.empty()) extras[std::string(kKernelGroupsKey)] = groups;
}

Eigen::Affine3d node_placement(const Json& node) {
  Eigen::Affine3d placement = Eigen::Affine3d::Identity();
  if (node.contains("matrix")) {
    const auto m = node.at("matrix").get<std::vector<double>>();
    placement.matrix() = Eigen::Map<const Eigen::Matrix4d>(m.data());
    return placement;
  }
  if (node.contains("translation")) {
    const auto t = node.at("translation").get<std::vector<double>>();
    placement.translate(Eigen::Vector3d(t[0], t[1], t[2]));
  }
  if (node.contains("rotation")) {
    const auto r = node.at("rotation").get<std::vector<double>>();
    placement.rotate(Eigen::Quaterniond(r[3], r[0], r[1], r[2]).normalized());
  }
  if (node.contains("scale")) {
    const auto s = node.at("scale").get<std::vector<double>>();
    placement.scale(Eigen::Vector3d(s[0], s[1], s[2]));
  }
  return placement;
}

// Where each mesh hangs; the file has been read by load_model before, so its tree is one.
Result<std::vector<std::optional<Eigen::Affine3d>>> mesh_placements(const Json& json,
                                                                    const std::string& name) {
  const Json none = Json::array();
  const Json& nodes = json.contains("nodes") ? json.at("nodes") : none;
  std::vector<std::optional<Eigen::Affine3d>> placements(json.at("meshes").size());
  std::optional<std::size_t> shared, moved;
  const std::function<void(std::size_t, const Eigen::Affine3d&, int)> walk =
      [&](std::size_t index, const Eigen::Affine3d& parent, int depth) {
        if (depth > kMaxModelDepth) return;
        const Json& node = nodes.at(index);
        const Eigen::Affine3d placement = parent * node_placement(node);
        if (node.contains("mesh")) {
          const auto mesh = node.at("mesh").get<std::size_t>();
          if (placements.at(mesh)) shared = mesh;
          const Json extensions = node.value("extensions", Json::object());
          if (node.contains("skin") || extensions.contains("EXT_mesh_gpu_instancing")) moved = mesh;
          placements[mesh] = placement;
        }
        if (!node.contains("children")) return;
        for (const Json& child : node.at("children")) {
          walk(child.get<std::size_t>(), placement, depth + 1);
        }
      };
  if (json.contains("scenes") && !json.at("scenes").empty()) {
    const Json& scene = json.at("scenes").at(json.value("scene", std::size_t{0}));
    for (const Json& node : scene.contains("nodes") ? scene.at("nodes") : none) {
      walk(node.get<std::size_t>(), Eigen::Affine3d::Identity(), 1);
    }
  } else if (nodes.empty()) {
    placements.assign(placements.size(), Eigen::Affine3d::Identity());
  } else {
    std::vector<bool> is_child(nodes.size(), false);
    for (const Json& node : nodes) {
      if (!node.contains("children")) continue;
      for (const Json& child : node.at("children")) is_child.at(child.get<std::size_t>()) = true;
    }
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      if (!is_child[i]) walk(i, Eigen::Affine3d::Identity(), 1);
    }
  }
  if (shared) {
    return fail(
        "{}: meshes/{}: hangs in the scene more than once, so its vertices have several "
        "kernels; export the copies as meshes of their own",
        name, *shared);
  }
  if (moved) {
    return fail(
        "{}: meshes/{}: is placed by a skin or by instancing; store the kernels in a .json file",
        name, *moved);
  }
  return placements;
}

Result<std::vector<std::uint8_t>> add_to_chunks(std::span<const std::uint8_t> glb,
                                                const KernelFile& kernels,
                                                const std::string& name) {
  if (glb.size() < 20 || word_at(glb, 0) != kMagic || word_at(glb, 16) != kJsonChunk ||
      word_at(glb, 12) > glb.size() - 20) {
    return fail("{}: is not a binary glTF file; export it again", name);
  }
  const std::size_t json_size = word_at(glb, 12);
  const auto* text = reinterpret_cast<const char*>(glb.data()) + 20;
  Json json = Json::parse(text, text + json_size);
  std::vector<std::uint8_t> binary;
  const std::size_t chunk = 20 + json_size;
  if (glb.size() >= chunk + 8 && word_at(glb, chunk + 4) == kBinaryChunk &&
      word_at(glb, chunk) <= glb.size() - chunk - 8) {
    const auto bytes = glb.subspan(chunk + 8, word_at(glb, chunk));
    binary.assign(bytes.begin(), bytes.end());
  }
  if (json.contains("buffers") && !json.at("buffers").empty() &&
      json.at("buffers").at(0).contains("uri")) {
    return fail("{}: buffers/0: lies in another file; export a .glb that holds all of its data",
                name);
  }
  const auto placements = mesh_placements(json, name);
  if (!placements) return tl::unexpected(placements.error());
  const Readers readers = readers_of(json);
  BinaryWriter writer(json, std::move(binary));
  std::size_t first = 0;
  for (std::size_t m = 0; m < json.at("meshes").size(); ++m) {
    const Eigen::Affine3d T_root_mesh = (*placements)[m].value_or(Eigen::Affine3d::Identity());
    const Eigen::Affine3d T_mesh_root = T_root_mesh.inverse();
    if (!T_mesh_root.matrix().allFinite()) {
      return fail("{}: meshes/{}: is flattened by its node; store the kernels in a .json file",
                  name, m);
    }
    Json& mesh = json.at("meshes").at(m);
    for (std::size_t p = 0; p < mesh.at("primitives").size(); ++p) {
      const auto positions =
          mesh.at("primitives").at(p).at("attributes").at("POSITION").get<std::size_t>();
      const auto count = json.at("accessors").at(positions).at("count").get<std::size_t>();
      if (first + count > kernels.kernels.size()) {
        return fail("{}: meshes/{}: has more vertices than there are kernels", name, m);
      }
      std::vector<glm::vec3> local(count);
      for (std::size_t i = 0; i < count; ++i) {
        const Eigen::Vector3d k = T_mesh_root * to_file_axes(to_eigen(kernels.kernels[first + i]));
        local[i] = {static_cast<float>(k.x()), static_cast<float>(k.y()),
                    static_cast<float>(k.z())};
      }
      first += count;
      Json& attributes = mesh.at("primitives").at(p).at("attributes");
      if (!replace_vectors(json, readers, writer, attributes, local)) {
        attributes["_SHADOW_KERNEL"] = writer.add_vectors(local);
      }
    }
    note_kernels(mesh, (T_mesh_root.linear() * to_file_axes(kernels.up)).normalized(),
                 kernels.geometry, kernels.groups);
  }
  return writer.finish();
}

std::size_t add_vertices(BinaryWriter& writer, Json& json, const Mesh& mesh) {
  std::vector<glm::vec3> points(mesh.positions.size());
  glm::vec3 low(std::numeric_limits<float>::max());
  glm::vec3 high(std::numeric_limits<float>::lowest());
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i] = to_file_axes(mesh.positions[i]);
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], points[i][axis]);
      high[axis] = std::max(high[axis], points[i][axis]);
    }
  }
  const std::size_t accessor = writer.add_vectors(points);
  json.at("accessors").at(accessor)["min"] = {low.x, low.y, low.z};
  json.at("accessors").at(accessor)["max"] = {high.x, high.y, high.z};
  return accessor;
}

// A run of a mesh's faces from one node, with vertices of its own.
struct NamedMesh {
  Mesh mesh;
  std::optional<std::uint32_t> node;  // of Model::nodes
};

constexpr std::uint32_t kNoVertex = std::numeric_limits<std::uint32_t>::max();

// `new_index`: one kNoVertex per vertex of the mesh, before and after.
Mesh faces_of(const Mesh& mesh, const NodeFaces& run, std::vector<std::uint32_t>& new_index) {
  Mesh own;
  own.name = mesh.name;
  own.material = mesh.material;
  const auto copy = [](auto& to, const auto& from, std::uint32_t vertex) {
    if (!from.empty()) to.push_back(from[vertex]);
  };
  for (std::size_t i = 0; i < run.index_count; ++i) {
    const std::uint32_t vertex = mesh.indices[run.first_index + i];
    std::uint32_t& index = new_index[vertex];
    if (index == kNoVertex) {
      index = static_cast<std::uint32_t>(own.positions.size());
      copy(own.positions, mesh.positions, vertex);
      copy(own.normals, mesh.normals, vertex);
      copy(own.texcoords, mesh.texcoords, vertex);
      copy(own.colors, mesh.colors, vertex);
      copy(own.source_vertex, mesh.source_vertex, vertex);
    }
    own.indices.push_back(index);
  }
  for (std::size_t i = 0; i < run.index_count; ++i) {
    new_index[mesh.indices[run.first_index + i]] = kNoVertex;
  }
  return own;
}

// The faces in the same order, each with its node: groups of parts are named by it.
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

// The stamp for the model as the file will have it: a vertex that two nodes share is two there.
std::string stamp_of(const std::vector<NamedMesh>& pieces, const std::string& stamp) {
  Model written;
  for (const NamedMesh& piece : pieces) {
    const auto same =
        std::find_if(written.meshes.begin(), written.meshes.end(),
                     [&piece](const Mesh& mesh) { return mesh.material == piece.mesh.material; });
    if (same == written.meshes.end()) {
      written.meshes.push_back(piece.mesh);
    } else {
      append_mesh(*same, piece.mesh);
    }
  }
  const std::size_t rest = stamp.find('-');
  return geometry_key(written) + (rest == std::string::npos ? "" : stamp.substr(rest));
}

// A node of the scene for the mesh that was written last, below nodes with its ancestors' names.
void add_named_node(Json& json, const Model& model, const NamedMesh& piece) {
  json["nodes"].push_back({{"mesh", json["meshes"].size() - 1}});
  std::size_t top = json["nodes"].size() - 1;
  if (!piece.node) {
    json["nodes"][top]["name"] = piece.mesh.name;
  } else {
    json["nodes"][top]["name"] = model.nodes[*piece.node].name;
    for (int parent = model.nodes[*piece.node].parent; parent >= 0;
         parent = model.nodes[static_cast<std::size_t>(parent)].parent) {
      json["nodes"].push_back({{"name", model.nodes[static_cast<std::size_t>(parent)].name},
                               {"children", Json::array({top})}});
      top = json["nodes"].size() - 1;
    }
  }
  json["scenes"][0]["nodes"].push_back(top);
}

Result<std::vector<std::uint8_t>> make_chunks(const Model& model, const KernelFile& kernels) {
  Json json;
  json["asset"] = {{"version", "2.0"}, {"generator", "penumbra kernels"}};
  json["scene"] = 0;
  json["scenes"] = Json::array({{{"nodes", Json::array()}}});
  BinaryWriter writer(json, {});
  for (const Material& from : model.materials) {
    const glm::vec4& c = from.base_color;
    Json material = {{"name", from.name},
                     {"pbrMetallicRoughness",
                      {{"baseColorFactor", {c.r, c.g, c.b, c.a}},
                       {"metallicFactor", from.metallic},
                       {"roughnessFactor", from.roughness}}},
                     {"emissiveFactor", {from.emissive.r, from.emissive.g, from.emissive.b}}};
    material["doubleSided"] = from.double_sided;
    if (c.a < 1.0F) material["alphaMode"] = "BLEND";
    json["materials"].push_back(std::move(material));
  }
  const std::vector<NamedMesh> pieces = split_by_node(model);
  const std::string stamp = stamp_of(pieces, kernels.geometry);
  for (const NamedMesh& piece : pieces) {
    const Mesh& from = piece.mesh;
    Json attributes;
    attributes["POSITION"] = add_vertices(writer, json, from);
    std::vector<glm::vec3> vectors;
    for (const glm::vec3& n : from.normals) vectors.push_back(to_file_axes(n));
    attributes["NORMAL"] = writer.add_vectors(vectors);
    if (!from.colors.empty()) {
      attributes["COLOR_0"] = writer.add(std::span<const glm::vec4>(from.colors), kFloat, "VEC4",
                                         from.colors.size(), kArrayBuffer);
    }
    if (!from.texcoords.empty()) {
      attributes["TEXCOORD_0"] = writer.add(std::span<const glm::vec2>(from.texcoords), kFloat,
                                            "VEC2", from.texcoords.size(), kArrayBuffer);
    }
    vectors.clear();
    for (const std::uint32_t source : from.source_vertex) {
      vectors.push_back(to_file_axes(kernels.kernels.at(source)));
    }
    attributes["_SHADOW_KERNEL"] = writer.add_vectors(vectors);
    const std::size_t indices =
        writer.add(std::span<const std::uint32_t>(from.indices), kUnsignedInt, "SCALAR",
                   from.indices.size(), kElementArrayBuffer);
    Json primitive = {{"attributes", std::move(attributes)}, {"indices", indices}};
    primitive["material"] = from.material;
    const bool has_name = piece.node && !model.nodes[*piece.node].mesh.empty();
    Json mesh = {{"name", has_name ? model.nodes[*piece.node].mesh : from.name},
                 {"primitives", Json::array({std::move(primitive)})}};
    note_kernels(mesh, to_file_axes(kernels.up), stamp, kernels.groups);
    json["meshes"].push_back(std::move(mesh));
    add_named_node(json, model, piece);
  }
  return writer.finish();
}

}  // namespace

Result<std::vector<std::uint8_t>> add_kernels_to_glb(std::span<const std::uint8_t> glb,
                                                     const KernelFile& kernels,
                                                     const std::string& name) {
  try {
    return add_to_chunks(glb, kernels, name);
  } catch (const std::exception& error) {
    return fail("{}: kernels can't be added: {}", name, error.what());
  }
}

Result<std::vector<std::uint8_t>> make_glb_with_kernels(const Model& model,
                                                        const KernelFile& kernels) {
  try {
    return make_chunks(model, kernels);
  } catch (const std::exception& error) {
    return fail("{}: can't be written as glTF: {}", model.name, error.what());
  }
}

}  // namespace penumbra
