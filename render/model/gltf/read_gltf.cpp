// .glb and .gltf -> Model, in the file's own axes (y up).
#include <algorithm>

#include "core/propagate.hpp"
#include "core/text/file.hpp"
#include "render/model/gltf/buffers.hpp"
#include "render/model/gltf/container.hpp"
#include "render/model/gltf/document.hpp"
#include "render/model/gltf/extensions.hpp"
#include "render/model/gltf/materials.hpp"
#include "render/model/gltf/mesh_uses.hpp"
#include "render/model/gltf/meshes.hpp"
#include "render/model/gltf/nodes.hpp"
#include "render/model/gltf/place.hpp"
#include "render/model/gltf/skins.hpp"
#include "render/model/gltf/stored_kernels.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra {
namespace gltf {
namespace {

// Reads the scene of a document. The output of tinygltf is not trusted: every index, range and
// number is checked.
class Reader {
 public:
  Reader(std::string name, const Document& document, Buffers& buffers, const ModelLimits& limits)
      : name_(std::move(name)),
        limits_(limits),
        gltf_(document.model),
        pose_(rest_pose(name_, gltf_)),
        accessors_(name_, gltf_, buffers, limits),
        materials_(name_, document, accessors_, buffers, limits, model_, notes_),
        meshes_(name_, gltf_, accessors_, materials_, limits, model_, notes_),
        nodes_(name_, gltf_, pose_, model_),
        skins_(name_, gltf_, accessors_, nodes_),
        placer_(name_, limits, model_, notes_),
        kernels_(name_, model_) {}

  [[nodiscard]] Result<Model> read();
  [[nodiscard]] double file_step() const { return placer_.file_step(); }
  // Keeps in `uses` where read() puts meshes.
  void keep_uses(std::vector<MeshUse>& uses) { uses_ = &uses; }

 private:
  [[nodiscard]] std::vector<bool> used_materials(const std::vector<Placement>& placements) const;
  [[nodiscard]] Result<void> collect(const Placement& placement);
  [[nodiscard]] Result<std::vector<double>> morph_weights(
      const Placement& placement, const std::vector<Primitive>& primitives) const;
  // Returns one placement, or one per instance.
  [[nodiscard]] Result<std::vector<VertexPlacement>> vertex_placements(const Placement& placement);

  std::string name_;
  const ModelLimits& limits_;
  const tinygltf::Model& gltf_;
  Model model_;
  Notes notes_;
  Pose pose_;
  Accessors accessors_;
  MaterialReader materials_;
  MeshReader meshes_;
  Nodes nodes_;
  Skins skins_;
  Placer placer_;
  StoredKernels kernels_;
  std::vector<MeshUse>* uses_ = nullptr;
};

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
      to.T_root_vertex.push_back(blended(primitive.skin, i, *vertices.joint_matrices));
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

// Those of the node, else of the mesh, else 0 (glTF 2.0, 3.7.2.2).
Result<std::vector<double>> Reader::morph_weights(const Placement& placement,
                                                  const std::vector<Primitive>& primitives) const {
  std::vector<double> weights;
  std::string place = fmt::format("nodes/{}/weights", placement.node);
  if (placement.node >= 0) weights = pose_.morph_weights[static_cast<std::size_t>(placement.node)];
  if (weights.empty()) {
    weights = gltf_.meshes[static_cast<std::size_t>(placement.mesh)].weights;
    place = fmt::format("meshes/{}/weights", placement.mesh);
  }
  for (const Primitive& primitive : primitives) {
    if (!weights.empty() && weights.size() != primitive.targets.size()) {
      return fail("{}: {}: are {} for the {} morph targets of {}", name_, place, weights.size(),
                  primitive.targets.size(), primitive.place);
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
    // The node's own transform is ignored (glTF 2.0, 3.7.3.3), except by primitives without joints.
    if (node.extensions.contains(kInstancing)) {
      notes_.add(fmt::format("is skinned; its instances ({}) are ignored", kInstancing),
                 placement.place);
    }
    PENUMBRA_TRY(const auto matrices, skins_.joint_matrices(node.skin));
    result.push_back({placement.T_root_node, matrices});
    return result;
  }
  const std::size_t most = limits_.max_vertices / meshes_.vertex_count(placement.mesh);
  PENUMBRA_TRY(
      const auto instances,
      instances_of(name_, node, fmt::format("nodes/{}", placement.node), accessors_, most));
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
    return fail("{}: nodes/{}/skin: names skin {}, there are {}", name_, placement.node, skin,
                gltf_.skins.size());
  }
  PENUMBRA_TRY(const auto primitives, meshes_.mesh(placement.mesh, skin >= 0));
  PENUMBRA_TRY(const std::vector<double> weights, morph_weights(placement, *primitives));
  if (meshes_.vertex_count(placement.mesh) == 0) return {};
  PENUMBRA_TRY(auto vertex_placements_of, vertex_placements(placement));
  const tinygltf::Value& extras = gltf_.meshes[static_cast<std::size_t>(placement.mesh)].extras;
  for (VertexPlacement& vertices : vertex_placements_of) {
    PENUMBRA_TRY(const std::uint32_t shift, meshes_.source_shift_of_next_use(placement.mesh));
    vertices.source_shift = shift;
    if (uses_ != nullptr) uses_->push_back(use_of(placement, vertices, *primitives));
    // The stored direction of a skinned mesh is in the root frame.
    const Eigen::Matrix3d linear = skin >= 0 ? Eigen::Matrix3d(Eigen::Matrix3d::Identity())
                                             : vertices.T_root_mesh.topLeftCorner<3, 3>();
    if (skin >= 0 || keeps_surfaces(vertices.T_root_mesh)) {
      kernels_.take(extras, linear, placement.place);
    }
    for (const Primitive& primitive : *primitives) {
      if (vertices.joint_matrices != nullptr) {
        if (primitive.skin.per_vertex == 0) {
          notes_.add("has no joints and weights for its skin; it stands where its node is",
                     primitive.place);
        }
        const Result<void> joints = check_joints(name_, primitive, vertices.joint_matrices->size());
        if (!joints) return joints;
      }
      const Result<void> collected =
          placer_.collect({&primitive, weights, vertices, placement.model_node, placement.place});
      if (!collected) return collected;
    }
  }
  return {};
}

Result<Model> Reader::read() {
  model_.culls_back_faces = true;
  PENUMBRA_TRY(const std::vector<Placement> placements, nodes_.visible_meshes());
  PENUMBRA_TRY_VOID(materials_.read(used_materials(placements)));
  PENUMBRA_TRY_VOID(meshes_.number_vertices());
  for (const Placement& placement : placements) {
    PENUMBRA_TRY_VOID(collect(placement));
  }
  PENUMBRA_TRY_VOID(placer_.place_all());
  if (model_.meshes.empty()) {
    const std::string cause = notes_.first_line(name_);
    if (!cause.empty()) return fail("{}; the scene shows nothing else", cause);
    return fail("{}: its scene shows no triangles; export the model with its faces", name_);
  }
  for (std::string& line : notes_.lines(name_)) model_.warnings.push_back(std::move(line));
  kernels_.finish();
  return std::move(model_);
}

// Facts about a file that its model does not hold.
struct FileNotes {
  double step = 0.0;                     // resolution of its coordinates
  std::vector<MeshUse>* uses = nullptr;  // null: not wanted
};

Result<Model> read_bytes(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                         bool binary, const ModelLimits& limits, FileNotes& notes) {
  const std::string name = file.string();
  Container container{{reinterpret_cast<const char*>(bytes.data()), bytes.size()}, {}};
  if (binary) {
    PENUMBRA_TRY(Container opened, open_glb(name, bytes));
    container = opened;
  }
  PENUMBRA_TRY(Document document, parse_document(name, container.json));
  PENUMBRA_TRY_VOID(check_required(name, document));
  Buffers buffers(file, std::move(document.buffers), container.binary, limits.max_file_bytes);
  Reader reader(name, document, buffers, limits);
  if (notes.uses != nullptr) reader.keep_uses(*notes.uses);
  Result<Model> model = reader.read();
  if (!model) return model;
  notes.step = reader.file_step();
  std::vector<std::string> ignored = ignored_content(name, document);
  model->warnings.insert(model->warnings.begin(), ignored.begin(), ignored.end());
  model->warnings.insert(model->warnings.end(), buffers.warnings().begin(),
                         buffers.warnings().end());
  return model;
}

}  // namespace

Result<std::vector<MeshUse>> mesh_uses(const std::filesystem::path& file) {
  const ModelLimits limits;
  PENUMBRA_TRY(const std::vector<std::uint8_t> bytes, read_file(file, limits.max_file_bytes));
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  std::vector<MeshUse> uses;
  FileNotes notes{.uses = &uses};
  PENUMBRA_TRY_VOID(read_bytes(file, bytes, text.starts_with("glTF"), limits, notes));
  return uses;
}

}  // namespace gltf

Result<Model> read_gltf(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                        bool binary, const ModelLimits& limits, double& file_step) {
  gltf::FileNotes notes;
  Result<Model> model = gltf::read_bytes(file, bytes, binary, limits, notes);
  file_step = notes.step;
  return model;
}

}  // namespace penumbra
