// A model in memory: triangles with materials, ready to draw and to cast shadows. Object frame: z
// up, metres.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/text/enum_names.hpp"
#include "render/gl/texture_sampling.hpp"

namespace penumbra {

// An RGBA8 image, rows top to bottom; colours are sRGB-encoded.
struct Texture {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> rgba;
  std::vector<std::uint8_t> encoded = {};  // the image file; only kept for OBJ
};

struct MaterialTexture {
  int image = -1;     // index into Model::textures; -1: none
  int texcoords = 0;  // 0: by Mesh::texcoords; 1: by Mesh::texcoords_2
  TextureSampling sampling;
};

// glTF's alpha modes. mask: transparent below a cutoff.
enum class AlphaMode { opaque, mask, blend };

// Emitted light that is far brighter than white; larger factors make no difference.
inline constexpr float kMaxEmissive = 1e4F;

// Factors, each multiplied by its texture.
struct Material {
  std::string name;
  glm::vec4 base_color{1.0F};  // linear light; w: opacity, except in mode opaque
  glm::vec3 emissive{0.0F};    // linear light; up to kMaxEmissive
  float metallic = 0.0F;
  float roughness = 0.8F;
  bool double_sided = false;
  bool unlit = false;  // drawn in the base colour, without lights and shadows
  AlphaMode alpha_mode = AlphaMode::opaque;
  float alpha_cutoff = 0.5F;
  float normal_scale = 1.0F;                   // factor on x and y of the normal texture
  float occlusion_strength = 1.0F;             // 0: the texture has no effect
  MaterialTexture base_color_texture;          // colour and opacity
  MaterialTexture metallic_roughness_texture;  // green: roughness, blue: metallic
  MaterialTexture normal_texture;              // in the frame of Mesh::tangents
  MaterialTexture occlusion_texture;           // red: visible fraction of the ambient light
  MaterialTexture emissive_texture;            // colour

  // Returns true if the material may reflect the video, as smooth metal does; the weight of the
  // reflection is in object.frag.glsl.
  [[nodiscard]] bool reflects() const {
    const float min_roughness = metallic_roughness_texture.image >= 0 ? 0.0F : roughness;
    return metallic * (1.0F - min_roughness) > 0.25F && !unlit;
  }
  // Returns true if drawing needs more than the base colour and its texture by Mesh::texcoords.
  [[nodiscard]] bool needs_map_program() const {
    return reflects() || metallic_roughness_texture.image >= 0 || normal_texture.image >= 0 ||
           occlusion_texture.image >= 0 || emissive_texture.image >= 0 ||
           base_color_texture.texcoords != 0 || alpha_mode != AlphaMode::opaque;
  }
};

// A named element of the file: a node of glTF with its mesh, an object or group of OBJ.
struct ModelNode {
  std::string name;
  std::string mesh;  // glTF: the mesh's name
  int parent = -1;   // index of an earlier node, or -1
};
// Consecutive triangles of a mesh that came from one node.
struct NodeFaces {
  std::uint32_t node = 0;       // index into Model::nodes
  std::size_t first_index = 0;  // into Mesh::indices
  std::size_t index_count = 0;
};

// One draw: an indexed triangle list with one material.
struct Mesh {
  std::string name;                  // glTF: the first mesh merged into this; OBJ: the material
  std::vector<glm::vec3> positions;  // [m]
  std::vector<glm::vec3> normals;    // unit, one per position
  std::vector<glm::vec2> texcoords;  // one per position, or empty; (0, 0) at the texture's top left
  std::vector<glm::vec2> texcoords_2;  // a second set, for textures with another layout
  // One per position, or empty. xyz: unit, x axis of the normal texture; its y axis is
  // cross(normal, tangent) * w.
  std::vector<glm::vec4> tangents;
  std::vector<glm::vec4> colors;  // linear, one per position, or empty
  std::vector<std::uint32_t> indices;
  // For each vertex: its index in the model file, to which kernel files refer. OBJ: index of the
  // `v` line; glTF: counted over the primitives' POSITION accessors in the order of the file.
  std::vector<std::uint32_t> source_vertex;
  std::vector<NodeFaces> node_faces;  // ascending; empty after subdivided()
  // Shadow kernels that came with the model, one per position [m], or empty.
  std::vector<glm::vec3> shadow_kernels;
  int material = 0;
};

struct Model {
  std::string name;
  std::vector<Mesh> meshes;
  std::vector<Material> materials;
  std::vector<std::shared_ptr<const Texture>> textures;  // shared by the shapes of an animation
  std::vector<ModelNode> nodes;  // glTF: visible nodes; OBJ: objects and groups with faces
  // Positions, kernels and bounds are relative to this point of the file [m], object frame. Zero
  // unless the model lies far from its file's origin, where floats would lose its shape.
  // placed_model() (scene.hpp) adds it.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  glm::vec3 min_corner{0.0F};  // bounds over all meshes
  glm::vec3 max_corner{0.0F};
  std::uint32_t source_vertex_count = 0;
  // The up direction (unit) that Mesh::shadow_kernels were made for, if there are any.
  std::optional<glm::vec3> shadow_kernel_up;
  std::string shadow_kernel_geometry;  // KernelStamp of the kernels; "": unknown
  // Groups of parts (part_groups.hpp) of the stored kernels. Used if the scene gives no groups.
  std::vector<std::string> shadow_kernel_groups;
  // Faces are visible only from the front (counter-clockwise), unless their material is
  // double-sided.
  bool culls_back_faces = false;
  std::vector<std::string> warnings;  // about ignored content of the file
  // Files that were read: the model's own first, then its buffers, materials and images, which are
  // all in its folder or below. Empty for a model that was not read from a file.
  std::vector<std::filesystem::path> files;

  [[nodiscard]] std::size_t vertex_count() const;
  [[nodiscard]] std::size_t triangle_count() const;
};

// by_format: glTF is y up and converted, (x, y, z) -> (x, -z, y); OBJ is z up.
enum class UpAxis { by_format, y, z };
inline constexpr auto kUpAxisNames =
    std::to_array<EnumName<UpAxis>>({{UpAxis::y, "y"}, {UpAxis::z, "z"}});  // without by_format

struct ModelLimits {
  std::size_t max_file_bytes = std::size_t{512} << 20U;
  std::size_t max_vertices = 20'000'000;
  std::size_t max_triangles = 20'000'000;
  std::size_t max_morph_vectors = 60'000'000;  // displacements and changes of normals and tangents
  std::size_t max_texture_pixels = std::size_t{64} << 20U;
  double max_coordinate_m = 1e6;  // from Model::origin
  std::size_t max_meshes = 4096;  // each is one draw call
};

// A shape of a model with animations.
struct ModelPose {
  std::string animation = "0";  // name or index, or "all"; of equal names, the first one
  double time_s = 0.0;          // limited to the times of the animation's keys
};

// Options of load_model().
struct ModelLoadOptions {
  UpAxis up = UpAxis::by_format;
  double unit_m = 1.0;                 // length of the file's unit [m]; glTF's is the metre
  bool stored_kernels = true;          // reads the shadow kernels of the file
  std::optional<ModelPose> pose = {};  // nullopt: the rest pose
  ModelLimits limits = {};
};

// Loads a .glb, .gltf or .obj file and validates it: finite numbers, index ranges, accessors inside
// their buffers, counts and sizes. Reads external files only from the model's folder. Errors
// contain the file and the cause.
[[nodiscard]] Result<Model> load_model(const std::filesystem::path& file,
                                       const ModelLoadOptions& reading = {});

// Makes the model's coordinates relative to `origin`, without moving it.
void move_origin(Model& model, const Eigen::Vector3d& origin);

// Returns a hash of all positions and faces, which determine shadow kernels.
[[nodiscard]] std::string geometry_key(const Model& model);

// Splits edges longer than `max_edge_m`, to follow the lens distortion. Stops at `max_triangles`.
[[nodiscard]] Mesh subdivided(const Mesh& mesh, float max_edge_m,
                              std::size_t max_triangles = 500'000);

}  // namespace penumbra
