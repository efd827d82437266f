// Reads .glb and .gltf files, in the file's own axes (y up).
#include <algorithm>
#include <glm/geometric.hpp>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/gltf/buffers.hpp"
#include "render/model/gltf/document.hpp"
#include "render/model/gltf/extensions.hpp"
#include "render/model/gltf/materials.hpp"
#include "render/model/gltf/mesh_uses.hpp"
#include "render/model/gltf/meshes.hpp"
#include "render/model/gltf/nodes.hpp"
#include "render/model/gltf/placer.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {
namespace gltf {
namespace {

// Reads the scene of a document. Validates every index, range and number in tinygltf's output.
class Reader {
 public:
  // `uses`: if not null, receives the uses of meshes in read().
  Reader(const Document& document, Buffers& buffers, const ModelLimits& limits,
         std::vector<MeshUse>* uses)
      : limits_(limits),
        document_(document),
        gltf_(document.model),
        buffers_(buffers),
        uses_(uses),
        accessors_(gltf_, buffers, limits),
        materials_(document, accessors_, buffers, limits, model_, notes_),
        meshes_(gltf_, accessors_, materials_, limits, model_, notes_),
        nodes_(gltf_, accessors_, model_),
        placer_(limits, model_, notes_) {}

  [[nodiscard]] Result<Model> read();
  [[nodiscard]] double file_step() const { return placer_.file_step(); }

 private:
  [[nodiscard]] std::vector<bool> used_materials(const std::vector<Placement>& placements) const;
  [[nodiscard]] Result<void> collect(const Placement& placement);
  [[nodiscard]] Result<std::vector<double>> morph_weights(
      const Placement& placement, const std::vector<Primitive>& primitives) const;
  // Returns one placement, or one per instance.
  [[nodiscard]] Result<std::vector<VertexPlacement>> vertex_placements(const Placement& placement);
  void copy_kernel_metadata(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                            const std::string& what);
  void drop_ambiguous_kernels();

  const ModelLimits& limits_;
  const Document& document_;
  const tinygltf::Model& gltf_;
  Buffers& buffers_;
  std::vector<MeshUse>* uses_;
  Model model_;
  Notes notes_;
  Accessors accessors_;
  MaterialReader materials_;
  MeshReader meshes_;
  Nodes nodes_;
  Placer placer_;
  bool kernels_disagree_ = false;  // meshes have different up directions
};

// Returns the null value for a key that is absent.
const tinygltf::Value& value_of(const tinygltf::Value& object, std::string_view key) {
  static const tinygltf::Value kNull;
  const std::string name(key);
  return object.IsObject() && object.Has(name) ? object.Get(name) : kNull;
}

MeshUse use_of(const Placement& placement, const VertexPlacement& vertices,
               const std::vector<Primitive>& primitives) {
  MeshUse use{placement.node,
              placement.mesh,
              vertices.T_node_instance,
              vertices.joint_matrices != nullptr,
              {}};
  for (const Primitive& primitive : primitives) {
    const Mesh& mesh = primitive.mesh;
    PrimitiveUse& to = use.primitives.emplace_back();
    to.index = primitive.index;
    to.source_vertex = mesh.source_vertex.front() + vertices.source_shift;
    if (!use.is_skinned || primitive.skin.per_vertex == 0) {
      to.T_root_vertex.push_back(vertices.T_root_mesh);
      continue;
    }
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      to.T_root_vertex.push_back(primitive.skin.blended(i, *vertices.joint_matrices));
    }
  }
  for (PrimitiveUse& primitive : use.primitives) {
    primitive.is_hidden = std::ranges::none_of(primitive.T_root_vertex, keeps_surfaces);
  }
  return use;
}

std::vector<bool> Reader::used_materials(const std::vector<Placement>& placements) const {
  std::vector<bool> used(gltf_.materials.size(), false);
  for (const Placement& placement : placements) {
    const tinygltf::Mesh& mesh = gltf_.meshes[static_cast<std::size_t>(placement.mesh)];
    for (const tinygltf::Primitive& primitive : mesh.primitives) {
      if (has_surface(primitive) && has(gltf_.materials, primitive.material)) {
        used[static_cast<std::size_t>(primitive.material)] = true;
      }
    }
  }
  return used;
}

// Returns the weights of the node or, if absent, of the mesh; else empty (glTF 2.0, 3.7.2.2).
Result<std::vector<double>> Reader::morph_weights(const Placement& placement,
                                                  const std::vector<Primitive>& primitives) const {
  std::vector<double> weights;
  std::string json_path = fmt::format("nodes/{}/weights", placement.node);
  if (placement.node >= 0) weights = gltf_.nodes[static_cast<std::size_t>(placement.node)].weights;
  if (weights.empty()) {
    weights = gltf_.meshes[static_cast<std::size_t>(placement.mesh)].weights;
    json_path = fmt::format("meshes/{}/weights", placement.mesh);
  }
  for (const Primitive& primitive : primitives) {
    if (!weights.empty() && weights.size() != primitive.targets.size()) {
      return fail("{}: are {} for the {} morph targets of {}", json_path, weights.size(),
                  primitive.targets.size(), primitive.json_path);
    }
  }
  return weights;
}

Result<std::vector<VertexPlacement>> Reader::vertex_placements(const Placement& placement) {
  std::vector<VertexPlacement> result;
  if (placement.node < 0) {
    result.emplace_back();
    return result;
  }
  const tinygltf::Node& node = gltf_.nodes[static_cast<std::size_t>(placement.node)];
  if (node.skin >= 0) {
    // A skinned node's transform is ignored (glTF 2.0, 3.7.3.3), except for primitives without
    // joints.
    if (node.extensions.contains(kInstancing)) {
      notes_.add(fmt::format("is skinned; its instances ({}) are ignored", kInstancing),
                 placement.json_path);
    }
    PENUMBRA_TRY(const auto matrices, nodes_.joint_matrices(node.skin));
    result.push_back({placement.T_root_node, matrices});
    return result;
  }
  const std::size_t max_instances = limits_.max_vertices / meshes_.vertex_count(placement.mesh);
  PENUMBRA_TRY(const auto instances, nodes_.instances_of(placement.node, max_instances));
  for (const Eigen::Matrix4d& T_node_instance : instances) {
    result.push_back({placement.T_root_node * T_node_instance, nullptr});
    if (node.extensions.contains(kInstancing)) result.back().T_node_instance = T_node_instance;
  }
  return result;
}

Result<void> Reader::collect(const Placement& placement) {
  const int skin =
      placement.node < 0 ? -1 : gltf_.nodes[static_cast<std::size_t>(placement.node)].skin;
  if (skin >= 0 && !has(gltf_.skins, skin)) {
    return fail("nodes/{}/skin: names skin {}, there are {}", placement.node, skin,
                gltf_.skins.size());
  }
  PENUMBRA_TRY(const auto primitives, meshes_.mesh(placement.mesh, skin >= 0));
  PENUMBRA_TRY(const std::vector<double> weights, morph_weights(placement, *primitives));
  if (meshes_.vertex_count(placement.mesh) == 0) return {};
  PENUMBRA_TRY(auto vertex_placements_of, vertex_placements(placement));
  const tinygltf::Value& extras = gltf_.meshes[static_cast<std::size_t>(placement.mesh)].extras;
  for (VertexPlacement& vertices : vertex_placements_of) {
    PENUMBRA_TRY(vertices.source_shift, meshes_.source_shift_of_next_use(placement.mesh));
    if (uses_ != nullptr) uses_->push_back(use_of(placement, vertices, *primitives));
    // The kernel direction stored with a skinned mesh is in the root frame.
    const Eigen::Matrix3d linear = skin >= 0 ? Eigen::Matrix3d(Eigen::Matrix3d::Identity())
                                             : vertices.T_root_mesh.topLeftCorner<3, 3>();
    if (skin >= 0 || keeps_surfaces(vertices.T_root_mesh)) {
      copy_kernel_metadata(extras, linear, placement.json_path);
    }
    for (const Primitive& primitive : *primitives) {
      if (vertices.joint_matrices != nullptr) {
        if (primitive.skin.per_vertex == 0) {
          notes_.add("has no joints and weights for its skin; it stands where its node is",
                     primitive.json_path);
        }
        PENUMBRA_TRY_VOID(check_joints(primitive, vertices.joint_matrices->size()));
      }
      PENUMBRA_TRY_VOID(placer_.collect(
          {&primitive, weights, vertices, placement.model_node, placement.json_path}));
    }
  }
  return {};
}

// Copies the shadow kernels' metadata from a mesh's `extras` to the model. `linear` transforms the
// direction from the mesh's axes to the root's.
void Reader::copy_kernel_metadata(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                                  const std::string& what) {
  const tinygltf::Value& up = value_of(extras, kKernelUpKey);
  if (up.Type() == tinygltf::NULL_TYPE) return;
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  bool usable = up.IsArray() && up.ArrayLen() == 3;
  for (int i = 0; usable && i < 3; ++i) {
    usable = up.Get(i).IsNumber();
    if (usable) direction[i] = up.Get(i).GetNumberAsDouble();
  }
  direction = (linear * direction).stableNormalized();
  if (!usable || !direction.allFinite() || !(direction.norm() > 0.5)) {
    model_.warnings.push_back(fmt::format(
        "{}: {} is not a direction; its stored shadow kernels are not used", what, kKernelUpKey));
    return;
  }
  const glm::vec3 turned = to_glm(direction);
  if (model_.shadow_kernel_up && glm::dot(turned, *model_.shadow_kernel_up) < 0.99999F &&
      !kernels_disagree_) {
    model_.warnings.push_back(fmt::format(
        "{}: its shadow kernels are for another direction than those of other meshes", what));
    kernels_disagree_ = true;
  }
  model_.shadow_kernel_up = turned;
  const tinygltf::Value& geometry = value_of(extras, kKernelGeometryKey);
  if (geometry.IsString()) model_.shadow_kernel_geometry = geometry.Get<std::string>();
  if (!extras.Has(std::string(kKernelGroupsKey))) return;
  const tinygltf::Value& groups = value_of(extras, kKernelGroupsKey);
  std::vector<std::string> names;
  for (std::size_t i = 0; groups.IsArray() && i < groups.ArrayLen(); ++i) {
    const tinygltf::Value& group = groups.Get(static_cast<int>(i));
    if (group.IsString()) names.push_back(group.Get<std::string>());
  }
  if (!groups.IsArray() || names.size() != groups.ArrayLen() || names.size() > kMaxGroups) {
    model_.warnings.push_back(fmt::format("{}: {} is not a list of names; its parts are not joined",
                                          what, kKernelGroupsKey));
    return;
  }
  model_.shadow_kernel_groups = std::move(names);
}

// Drops the kernels if their direction is unknown or differs between meshes.
void Reader::drop_ambiguous_kernels() {
  if (kernels_disagree_) model_.shadow_kernel_up.reset();
  if (model_.shadow_kernel_up) return;
  for (Mesh& mesh : model_.meshes) mesh.shadow_kernels.clear();
}

Result<Model> Reader::read() {
  PENUMBRA_TRY_VOID(check_required(document_));
  model_.culls_back_faces = true;
  PENUMBRA_TRY(const std::vector<Placement> placements, nodes_.visible_meshes());
  PENUMBRA_TRY_VOID(materials_.read(used_materials(placements)));
  PENUMBRA_TRY_VOID(meshes_.number_vertices());
  for (const Placement& placement : placements) {
    PENUMBRA_TRY_VOID(collect(placement));
  }
  PENUMBRA_TRY_VOID(placer_.place_all());
  if (model_.meshes.empty()) {
    const std::string cause = notes_.first_line();
    if (!cause.empty()) return fail("{}; the scene shows nothing else", cause);
    return fail("its scene shows no triangles; export the model with its faces");
  }
  drop_ambiguous_kernels();
  std::vector<std::string> warnings = ignored_content(document_);
  warnings.insert(warnings.end(), model_.warnings.begin(), model_.warnings.end());
  notes_.append_to(warnings);
  warnings.insert(warnings.end(), buffers_.warnings().begin(), buffers_.warnings().end());
  model_.warnings = std::move(warnings);
  return std::move(model_);
}

// Like read_gltf(); also fills `uses` if it is not null.
Result<Model> read_bytes(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                         bool binary, const ModelLimits& limits, double& file_step,
                         std::vector<MeshUse>* uses) {
  const std::string name = file.string();
  Container container{{reinterpret_cast<const char*>(bytes.data()), bytes.size()}, {}};
  if (binary) {
    PENUMBRA_TRY(container, open_glb(name, bytes));
  }
  PENUMBRA_TRY(Document document, parse_document(name, container.json));
  Buffers buffers(file, std::move(document.buffers), container.binary, limits.max_file_bytes);
  Reader reader(document, buffers, limits, uses);
  Result<Model> model = reader.read();
  if (!model) return fail_in(name, model.error());
  file_step = reader.file_step();
  for (std::string& warning : model->warnings)
    warning = without_control_characters(name + ": " + warning);
  return model;
}

}  // namespace

Result<std::vector<MeshUse>> mesh_uses(const std::filesystem::path& file) {
  const ModelLimits limits;
  PENUMBRA_TRY(const std::vector<std::uint8_t> bytes, read_file(file, limits.max_file_bytes));
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  std::vector<MeshUse> uses;
  double file_step = 0.0;
  const bool binary = text.starts_with("glTF");
  PENUMBRA_TRY_VOID(read_bytes(file, bytes, binary, limits, file_step, &uses));
  return uses;
}

}  // namespace gltf

Result<Model> read_gltf(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                        bool binary, const ModelLimits& limits, double& file_step) {
  return gltf::read_bytes(file, bytes, binary, limits, file_step, nullptr);
}

}  // namespace penumbra
