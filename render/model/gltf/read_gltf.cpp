// Reads .glb and .gltf files, in the file's own axes (y up).
#include <algorithm>
#include <glm/geometric.hpp>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/gltf/animations.hpp"
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
        mesh_uses_(uses),
        accessors_(gltf_, buffers, limits),
        materials_(document, accessors_, buffers, limits, model_, notes_),
        meshes_(gltf_, accessors_, materials_, limits, model_, notes_),
        nodes_(gltf_, accessors_, model_),
        animations_(document, accessors_, limits, notes_) {}

  // Reads the file except the shape. `animation`: see Animations::read(); nullptr: none.
  [[nodiscard]] Result<void> read(const std::string* animation);
  // Returns the model in its rest pose, or at a time of its animation. Sets file_step().
  [[nodiscard]] Result<Model> at(std::optional<double> time_s);
  // Resolution of the file's coordinates after transformation.
  [[nodiscard]] double file_step() const { return file_step_; }
  [[nodiscard]] double end_s() const { return animations_.end_s(); }

 private:
  // A use of a mesh in the scene, before it is placed.
  struct Use {
    Placement placement;
    VertexPlacement vertices;
    const std::vector<Primitive>* primitives = nullptr;
    int skin = -1;  // of a mesh that its joints transform
    std::vector<double> rest_weights;
  };

  [[nodiscard]] std::vector<bool> used_materials(const std::vector<Placement>& placements) const;
  [[nodiscard]] Result<void> collect(const Placement& placement);
  [[nodiscard]] Result<std::vector<double>> morph_weights(
      const Placement& placement, const std::vector<Primitive>& primitives) const;
  // Returns one placement, or one per instance.
  [[nodiscard]] Result<std::vector<VertexPlacement>> vertex_placements(const Placement& placement);
  [[nodiscard]] Result<void> pose(Use& use);
  void copy_kernel_metadata(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                            const std::string& what);
  void drop_ambiguous_kernels(Model& model) const;

  const ModelLimits& limits_;
  const Document& document_;
  const tinygltf::Model& gltf_;
  Buffers& buffers_;
  std::vector<MeshUse>* mesh_uses_;
  Model model_;  // without meshes
  Notes notes_;
  Accessors accessors_;
  MaterialReader materials_;
  MeshReader meshes_;
  Nodes nodes_;
  Animations animations_;
  std::vector<Use> uses_;
  double file_step_ = 0.0;
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
    result.push_back({nodes_.T_root_mesh(placement), matrices});
    return result;
  }
  const std::size_t max_instances = limits_.max_vertices / meshes_.vertex_count(placement.mesh);
  PENUMBRA_TRY(const auto instances, nodes_.instances_of(placement.node, max_instances));
  for (const Eigen::Matrix4d& T_node_instance : instances) {
    result.push_back({nodes_.T_root_mesh(placement) * T_node_instance, nullptr});
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
  PENUMBRA_TRY(const auto weights, morph_weights(placement, *primitives));
  if (meshes_.vertex_count(placement.mesh) == 0) return {};
  PENUMBRA_TRY(auto vertex_placements_of, vertex_placements(placement));
  const tinygltf::Value& extras = gltf_.meshes[static_cast<std::size_t>(placement.mesh)].extras;
  for (VertexPlacement& vertices : vertex_placements_of) {
    PENUMBRA_TRY(vertices.source_shift, meshes_.source_shift_of_next_use(placement.mesh));
    if (mesh_uses_ != nullptr) mesh_uses_->push_back(use_of(placement, vertices, *primitives));
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
    }
    uses_.push_back(
        {placement, vertices, primitives, vertices.joint_matrices != nullptr ? skin : -1, weights});
  }
  return {};
}

// Applies the nodes' poses to the transforms of a use.
Result<void> Reader::pose(Use& use) {
  use.vertices.T_root_mesh = nodes_.T_root_mesh(use.placement);
  if (use.vertices.T_node_instance) use.vertices.T_root_mesh *= *use.vertices.T_node_instance;
  if (use.skin < 0) return {};
  PENUMBRA_TRY(use.vertices.joint_matrices, nodes_.joint_matrices(use.skin));
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
void Reader::drop_ambiguous_kernels(Model& model) const {
  if (kernels_disagree_) model.shadow_kernel_up.reset();
  if (model.shadow_kernel_up) return;
  for (Mesh& mesh : model.meshes) mesh.shadow_kernels.clear();
}

Result<void> Reader::read(const std::string* animation) {
  PENUMBRA_TRY_VOID(check_required(document_));
  model_.culls_back_faces = true;
  if (animation != nullptr) PENUMBRA_TRY_VOID(animations_.read(*animation));
  PENUMBRA_TRY(const std::vector<Placement> placements, nodes_.visible_meshes());
  PENUMBRA_TRY_VOID(materials_.read(used_materials(placements)));
  PENUMBRA_TRY_VOID(meshes_.number_vertices());
  for (const Placement& placement : placements) {
    PENUMBRA_TRY_VOID(collect(placement));
  }
  const std::vector<std::string> ignored = ignored_content(document_, animation != nullptr);
  model_.warnings.insert(model_.warnings.begin(), ignored.begin(), ignored.end());
  return {};
}

Result<Model> Reader::at(std::optional<double> time_s) {
  if (time_s) PENUMBRA_TRY_VOID(nodes_.set_poses(animations_.poses_at(*time_s)));
  Model model = model_;
  Notes notes = notes_;
  Placer placer(limits_, model, notes);
  for (Use& use : uses_) {
    if (time_s) PENUMBRA_TRY_VOID(pose(use));
    const NodePose* animated = nodes_.pose_of(use.placement.node);
    const bool morphs = animated != nullptr && !animated->weights.empty();
    for (const Primitive& primitive : *use.primitives) {
      PENUMBRA_TRY_VOID(
          placer.collect({&primitive, morphs ? animated->weights : use.rest_weights, use.vertices,
                          use.placement.model_node, use.placement.json_path}));
    }
  }
  PENUMBRA_TRY_VOID(placer.place_all());
  file_step_ = placer.file_step();
  if (model.meshes.empty() && !time_s) {
    const std::string cause = notes.first_line();
    if (!cause.empty()) return fail("{}; the scene shows nothing else", cause);
    return fail("its scene shows no triangles; export the model with its faces");
  }
  if (time_s && model.shadow_kernel_up) {
    model.shadow_kernel_up.reset();
    model.warnings.emplace_back(
        "its stored shadow kernels are for the rest pose; they are computed again");
  }
  drop_ambiguous_kernels(model);
  notes.append_to(model.warnings);
  model.files = buffers_.files();
  model.warnings.insert(model.warnings.end(), buffers_.warnings().begin(),
                        buffers_.warnings().end());
  return model;
}

// A file with its reader, which refers to the other members.
class File {
 public:
  // `bytes` must outlive the file. For the other arguments see Reader.
  [[nodiscard]] static Result<std::unique_ptr<File>> open(const std::filesystem::path& path,
                                                          std::span<const std::uint8_t> bytes,
                                                          bool binary, const ModelLimits& limits,
                                                          const std::string* animation,
                                                          std::vector<MeshUse>* uses);
  // See Reader. Adds the file's name to errors and warnings.
  [[nodiscard]] Result<Model> at(std::optional<double> time_s, double& file_step);
  [[nodiscard]] double end_s() const { return reader_.end_s(); }

 private:
  File(const std::filesystem::path& path, Document document, const Container& container,
       const ModelLimits& limits, std::vector<MeshUse>* uses)
      : name_(path.string()),
        limits_(limits),
        document_(std::move(document)),
        buffers_(path, std::move(document_.buffers), container.binary, limits.max_file_bytes),
        reader_(document_, buffers_, limits_, uses) {}

  std::string name_;
  ModelLimits limits_;
  Document document_;
  Buffers buffers_;
  Reader reader_;
};

Result<std::unique_ptr<File>> File::open(const std::filesystem::path& path,
                                         std::span<const std::uint8_t> bytes, bool binary,
                                         const ModelLimits& limits, const std::string* animation,
                                         std::vector<MeshUse>* uses) {
  const std::string name = path.string();
  Container container{{reinterpret_cast<const char*>(bytes.data()), bytes.size()}, {}};
  if (binary) {
    PENUMBRA_TRY(container, open_glb(name, bytes));
  }
  PENUMBRA_TRY(Document document, parse_document(name, container.json));
  std::unique_ptr<File> file(new File(path, std::move(document), container, limits, uses));
  PENUMBRA_TRY_VOID(with_place(name, file->reader_.read(animation)));
  return file;
}

Result<Model> File::at(std::optional<double> time_s, double& file_step) {
  PENUMBRA_TRY(Model model, with_place(name_, reader_.at(time_s)));
  file_step = reader_.file_step();
  for (std::string& warning : model.warnings)
    warning = without_control_characters(name_ + ": " + warning);
  return model;
}

}  // namespace

Result<std::vector<MeshUse>> mesh_uses(const std::filesystem::path& file) {
  const ModelLimits limits;
  PENUMBRA_TRY(const std::vector<std::uint8_t> bytes, read_file(file, limits.max_file_bytes));
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  std::vector<MeshUse> uses;
  const bool binary = text.starts_with("glTF");
  PENUMBRA_TRY_VOID(File::open(file, bytes, binary, limits, nullptr, &uses));
  return uses;
}

}  // namespace gltf

Result<Model> read_gltf(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                        bool binary, const ModelLimits& limits, double& file_step) {
  PENUMBRA_TRY(const auto opened, gltf::File::open(file, bytes, binary, limits, nullptr, nullptr));
  return opened->at(std::nullopt, file_step);
}

struct GltfShapes::Impl {
  std::vector<std::uint8_t> bytes;
  std::unique_ptr<gltf::File> file;
};

GltfShapes::GltfShapes(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
GltfShapes::GltfShapes(GltfShapes&&) noexcept = default;
GltfShapes::~GltfShapes() = default;

Result<GltfShapes> GltfShapes::open(const std::filesystem::path& file,
                                    std::vector<std::uint8_t> bytes, bool binary,
                                    const ModelLimits& limits, const std::string& animation) {
  auto impl = std::make_unique<Impl>();
  impl->bytes = std::move(bytes);
  PENUMBRA_TRY(impl->file,
               gltf::File::open(file, impl->bytes, binary, limits, &animation, nullptr));
  return GltfShapes(std::move(impl));
}

Result<Model> GltfShapes::at(double time_s, double& file_step) {
  return impl_->file->at(time_s, file_step);
}

double GltfShapes::end_s() const {
  return impl_->file->end_s();
}

}  // namespace penumbra
