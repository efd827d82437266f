#include "render/shadow/kernels/kernel_glb.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <span>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/gltf/extensions.hpp"
#include "render/model/gltf/mesh_uses.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/kernels/glb_document.hpp"

namespace penumbra {
namespace {

using Json = GlbDocument::Json;

// Reference counts of accessors and buffer views. Data that only old kernels use is overwritten.
struct ReferenceCounts {
  std::map<std::size_t, int> of_accessor, of_view;
};
ReferenceCounts references_of(const Json& json) {
  ReferenceCounts references;
  const auto count = [&references](const Json& accessor) {
    if (accessor.is_number_unsigned()) ++references.of_accessor[accessor.get<std::size_t>()];
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
  const auto count_view = [&references](const Json& from) {
    if (from.contains("bufferView")) ++references.of_view[from.at("bufferView").get<std::size_t>()];
  };
  for (const Json& accessor : json.at("accessors")) {
    count_view(accessor);
    if (!accessor.contains("sparse")) continue;
    for (const char* part : {"indices", "values"}) count_view(accessor.at("sparse").at(part));
  }
  for (const Json& image : list(json, "images")) count_view(image);
  return references;
}

// Overwrites existing kernels, so that the file does not grow when they are stored again. Returns
// false if their count differs, they are not dense, or their data is shared with another attribute.
bool replace_vectors(GlbDocument& document, const ReferenceCounts& references,
                     const Json& attributes, const std::vector<glm::vec3>& vectors) {
  const Json& json = document.json;
  const auto existing = attributes.find("_SHADOW_KERNEL");
  if (existing == attributes.end()) return false;
  const auto index = existing->get<std::size_t>();
  const Json& accessor = json.at("accessors").at(index);
  if (references.of_accessor.at(index) != 1 ||
      accessor.value("componentType", 0) != GlbDocument::kFloat ||
      accessor.value("type", "") != "VEC3" ||
      accessor.value("count", std::size_t{0}) != vectors.size() || accessor.contains("sparse") ||
      !accessor.contains("bufferView")) {
    return false;
  }
  const auto view_index = accessor.at("bufferView").get<std::size_t>();
  const Json& view = json.at("bufferViews").at(view_index);
  const bool dense = !view.contains("byteStride") || view.at("byteStride") == sizeof(glm::vec3);
  const bool sole = references.of_view.at(view_index) == 1 &&
                    view.value("byteLength", std::size_t{0}) == std::span(vectors).size_bytes() &&
                    accessor.value("byteOffset", std::size_t{0}) == 0 &&
                    !view.contains("extensions");  // not compressed
  if (!dense || !sole || view.value("buffer", 0) != 0) return false;
  return document.overwrite(view.value("byteOffset", std::size_t{0}), vectors);
}

// Erases the reference to compressed kernels, which take precedence over an accessor.
void erase_compressed_kernels(Json& primitive) {
  if (!primitive.contains("extensions") || !primitive.at("extensions").contains(gltf::kDraco))
    return;
  Json& draco = primitive.at("extensions").at(gltf::kDraco);
  if (draco.contains("attributes")) draco.at("attributes").erase("_SHADOW_KERNEL");
}

class KernelWriter {
 public:
  KernelWriter(GlbDocument& document, const KernelFile& kernels, double unit_m, std::string name)
      : document_(document),
        kernels_(kernels),
        unit_m_(unit_m),
        name_(std::move(name)),
        references_(references_of(document.json)) {}

  [[nodiscard]] Result<void> add(const gltf::MeshUse& use) {
    // A node of scale 0 is invisible: its mesh stays unchanged. Instances of scale 0 are dropped.
    if (std::ranges::all_of(use.primitives, &gltf::PrimitiveUse::is_hidden)) return {};
    bool is_copy = false;
    const std::size_t mesh = mesh_of(use, is_copy);
    for (const gltf::PrimitiveUse& primitive : use.primitives) {
      if (primitive.is_hidden) continue;
      // Copies the attributes, because adding accessors may reallocate the document.
      Json attributes = document_.json.at("meshes")
                            .at(mesh)
                            .at("primitives")
                            .at(primitive.index)
                            .at("attributes");
      const auto positions = attributes.at("POSITION").get<std::size_t>();
      const auto count =
          document_.json.at("accessors").at(positions).at("count").get<std::size_t>();
      PENUMBRA_TRY(const auto local, local_kernels(primitive, count));
      if (!is_copy && replace_vectors(document_, references_, attributes, local)) continue;
      attributes["_SHADOW_KERNEL"] = document_.add_vectors(local);
      Json& to = document_.json.at("meshes").at(mesh).at("primitives").at(primitive.index);
      to["attributes"] = std::move(attributes);
      erase_compressed_kernels(to);
    }
    const Eigen::Matrix4d& T_root_vertex = use.primitives.front().T_root_vertex.front();
    const Eigen::Matrix3d linear = use.is_skinned
                                       ? Eigen::Matrix3d(Eigen::Matrix3d::Identity())
                                       : Eigen::Matrix3d(T_root_vertex.topLeftCorner<3, 3>());
    write_extras(document_.json.at("meshes").at(mesh), kernels_,
                 (linear.inverse() * to_file_axes(kernels_.up)).normalized());
    return {};
  }

  // Removes instancing from nodes whose instances became nodes. Requires that all uses are added.
  void finish() {
    if (instances_.empty()) return;
    bool is_used = false;
    for (Json& node : document_.json.at("nodes")) {
      if (!node.contains("extensions")) continue;
      Json& extensions = node.at("extensions");
      const int index = static_cast<int>(&node - &document_.json.at("nodes").at(0));
      if (instances_.contains(index)) {
        // Erasing moves later elements, so `extensions` is not used afterwards.
        extensions.erase(gltf::kInstancing);
        if (extensions.empty()) node.erase("extensions");
        node.erase("mesh");
        node.erase("weights");
      } else {
        is_used = is_used || extensions.contains(gltf::kInstancing);
      }
    }
    for (const char* list : {"extensionsUsed", "extensionsRequired"}) {
      if (is_used || !document_.json.contains(list)) continue;
      Json& names = document_.json.at(list);
      std::erase_if(names.get_ref<Json::array_t&>(),
                    [](const Json& name) { return name == gltf::kInstancing; });
      if (names.empty()) document_.json.erase(list);
    }
  }

 private:
  // Returns the mesh itself for its first use, and a copy that shares its data for further uses.
  [[nodiscard]] std::size_t mesh_of(const gltf::MeshUse& use, bool& is_copy) {
    Json& meshes = document_.json.at("meshes");
    auto mesh = static_cast<std::size_t>(use.mesh);
    is_copy = !written_.insert(use.mesh).second;
    if (is_copy) {
      Json copy = meshes.at(mesh);
      meshes.push_back(std::move(copy));
      mesh = meshes.size() - 1;
    }
    if (use.T_node_instance) {
      add_instance(use, mesh);
    } else if (use.node >= 0) {
      document_.json.at("nodes").at(static_cast<std::size_t>(use.node))["mesh"] = mesh;
    }
    return mesh;
  }

  // Converts an instance to a child of its node, before the other children.
  void add_instance(const gltf::MeshUse& use, std::size_t mesh) {
    Json& nodes = document_.json.at("nodes");
    Json instance = {{"mesh", mesh}};
    instance["matrix"] =
        std::vector<double>(use.T_node_instance->data(), use.T_node_instance->data() + 16);
    const auto parent = static_cast<std::size_t>(use.node);
    if (nodes.at(parent).contains("weights")) instance["weights"] = nodes.at(parent).at("weights");
    nodes.push_back(std::move(instance));
    Json& node = nodes.at(parent);
    if (!node.contains("children")) node["children"] = Json::array();
    Json& children = node.at("children");
    const auto position = static_cast<std::ptrdiff_t>(instances_[use.node]++);
    children.insert(children.begin() + position, nodes.size() - 1);
  }

  [[nodiscard]] Result<std::vector<glm::vec3>> local_kernels(const gltf::PrimitiveUse& use,
                                                             std::size_t count) const {
    if (use.source_vertex + count > kernels_.kernels.size()) {
      return fail("{}: has more vertices than there are kernels", name_);
    }
    std::vector<Eigen::Affine3d> T_vertex_root;
    for (const Eigen::Matrix4d& T_root_vertex : use.T_root_vertex) {
      T_vertex_root.emplace_back(Eigen::Affine3d(T_root_vertex).inverse());
      if (!T_vertex_root.back().matrix().allFinite()) {
        return fail(
            "{}: one of its meshes is flattened by its node or joints; store the kernels in a "
            ".json file",
            name_);
      }
    }
    std::vector<glm::vec3> local(count);
    for (std::size_t i = 0; i < count; ++i) {
      const Eigen::Affine3d& T = T_vertex_root.at(T_vertex_root.size() == 1 ? 0 : i);
      const Eigen::Vector3d k =
          T * to_file_axes((kernels_.origin + to_eigen(kernels_.kernels[use.source_vertex + i])) /
                           unit_m_);
      local[i] = {k.x(), k.y(), k.z()};
    }
    return local;
  }

  GlbDocument& document_;
  const KernelFile& kernels_;
  double unit_m_;  // length unit of the file
  std::string name_;
  ReferenceCounts references_;
  std::set<int> written_;                 // meshes of the file with their first use done
  std::map<int, std::size_t> instances_;  // per node: number of nodes that replace its instances
};

Result<KernelGlb> add_to_document(const std::filesystem::path& file, const KernelFile& kernels,
                                  double unit_m) {
  KernelGlb result;
  PENUMBRA_TRY(const auto uses, gltf::mesh_uses(file));
  PENUMBRA_TRY(auto document, GlbDocument::open(file, result.warnings));
  KernelWriter writer(document, kernels, unit_m, file.string());
  for (const gltf::MeshUse& use : uses) {
    PENUMBRA_TRY_VOID(writer.add(use));
  }
  writer.finish();
  PENUMBRA_TRY(result.bytes, document.finish());
  return result;
}

}  // namespace

Result<KernelGlb> add_kernels_to_gltf(const std::filesystem::path& file, const KernelFile& kernels,
                                      double unit_m) {
  try {
    return add_to_document(file, kernels, unit_m);
  } catch (const std::exception& error) {
    return fail("{}: kernels can't be added: {}", file.string(), error.what());
  }
}

}  // namespace penumbra
