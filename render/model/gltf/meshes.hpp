// Reads primitives: attributes, faces, morph targets and skin weights, in the frame of their mesh.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/accessors.hpp"
#include "render/model/gltf/compression/draco_meshes.hpp"
#include "render/model/gltf/materials.hpp"
#include "render/model/gltf/notes.hpp"

namespace penumbra::gltf {

// Displacement of each vertex at a weight of 1; empty for attributes without displacement.
struct MorphTarget {
  std::vector<glm::vec3> positions;
  std::vector<glm::vec3> normals;
  std::vector<glm::vec3> tangents;
};

// The `per_vertex` joints that move each vertex, with weights that sum to 1.
struct SkinWeights {
  std::size_t per_vertex = 0;
  std::vector<std::uint32_t> joints;
  std::vector<double> weights;

  // Returns the weighted sum of the matrices of a vertex's joints.
  [[nodiscard]] Eigen::Matrix4d blended(std::size_t vertex,
                                        const std::vector<Eigen::Matrix4d>& joint_matrices) const;
};

struct Primitive {
  std::string json_path;  // JSON path in the file
  Mesh mesh;
  std::vector<MorphTarget> targets;
  SkinWeights skin;       // empty if the primitive has none or no skin uses it
  std::size_t index = 0;  // among the primitives of its mesh
};

// Returns true for a primitive of triangles with positions.
[[nodiscard]] bool has_surface(const tinygltf::Primitive& primitive);

// Fails if a vertex refers to a joint that the skin does not have.
[[nodiscard]] Result<void> check_joints(const Primitive& primitive, std::size_t joint_count);

// Reads a mesh when it is first needed, because unused meshes may be malformed.
class MeshReader {
 public:
  MeshReader(const tinygltf::Model& gltf, Accessors& accessors, const MaterialReader& materials,
             const ModelLimits& limits, Model& model, Notes& notes)
      : gltf_(gltf),
        accessors_(accessors),
        materials_(materials),
        limits_(limits),
        model_(model),
        notes_(notes),
        draco_(accessors, limits),
        meshes_(gltf.meshes.size()) {}

  // Numbers the vertices of all meshes, including unused ones.
  [[nodiscard]] Result<void> number_vertices();
  // Returns the primitives of a mesh that have a surface. `skinned`: reads their skin weights.
  [[nodiscard]] Result<const std::vector<Primitive>*> mesh(int index, bool skinned);

  // Returns the number of a mesh's vertices, including those of primitives without a surface.
  [[nodiscard]] std::size_t vertex_count(int mesh) const {
    return meshes_[static_cast<std::size_t>(mesh)].vertex_count;
  }

  // Counts a use of a mesh. Returns the offset of its vertex numbers from number_vertices(): 0 for
  // the first use; later uses are numbered after all existing vertices.
  [[nodiscard]] Result<std::uint32_t> source_shift_of_next_use(int mesh);

 private:
  struct Entry {
    std::optional<std::vector<Primitive>> primitives;
    std::vector<std::uint32_t> first_vertex;  // per primitive
    bool has_skin_weights = false;
    std::uint32_t vertex_count = 0;
    bool is_used = false;
  };
  [[nodiscard]] Result<void> read_mesh(std::size_t index, Entry& entry);
  [[nodiscard]] Result<Primitive> read_primitive(const tinygltf::Primitive& from,
                                                 const std::string& what,
                                                 std::uint32_t first_vertex);
  // Returns the elements of an attribute, compressed or not; no elements if there is none. `what`:
  // JSON path of the primitive.
  [[nodiscard]] Result<Elements> attribute(const tinygltf::Primitive& from, const std::string& key,
                                           const Shape& shape, const std::string& what);
  [[nodiscard]] Result<void> read_attributes(const tinygltf::Primitive& from,
                                             const std::string& what, Mesh& mesh);
  [[nodiscard]] Result<void> read_texcoords(const tinygltf::Primitive& from,
                                            const std::string& what, Mesh& mesh);
  [[nodiscard]] Result<void> read_targets(const tinygltf::Primitive& from, Primitive& to);
  [[nodiscard]] Result<SkinWeights> read_skin_weights(const tinygltf::Primitive& from,
                                                      const Primitive& to);
  [[nodiscard]] Result<std::vector<std::uint32_t>> corners(const tinygltf::Primitive& from,
                                                           std::size_t vertices,
                                                           const std::string& what);
  [[nodiscard]] Result<std::vector<std::uint32_t>> triangles(const tinygltf::Primitive& from,
                                                             std::size_t vertices,
                                                             const std::string& what);

  const tinygltf::Model& gltf_;
  Accessors& accessors_;
  const MaterialReader& materials_;
  const ModelLimits& limits_;
  Model& model_;
  Notes& notes_;
  DracoMeshes draco_;
  std::vector<Entry> meshes_;
  std::size_t morph_vectors_ = 0;  // of all targets read so far
};

}  // namespace penumbra::gltf
