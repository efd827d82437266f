// A model in memory: triangles with materials, ready to draw and to cast shadows. Object frame: z
// up, metres.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/gl/texture_sampling.hpp"

namespace penumbra {

// RGBA8, rows top to bottom; of colours sRGB-encoded.
struct Texture {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> rgba;
  std::vector<std::uint8_t> encoded =
      {};  // the file that it came in, where the format has no other
};

// What a material has of a texture.
struct MaterialTexture {
  int image = -1;     // index into Model::textures, or -1: none
  int texcoords = 0;  // 0: by Mesh::texcoords; 1: by Mesh::texcoords_2
  TextureSampling sampling;
};

// Of a surface: nothing shines through; or all where it is under a cutoff; or some.
enum class AlphaMode { opaque, mask, blend };

// Factors, and textures that they are multiplied with.
struct Material {
  std::string name;
  glm::vec4 base_color{1.0F};  // linear light; w: opacity, where the alpha mode asks for it
  glm::vec3 emissive{0.0F};    // linear light
  float metallic = 0.0F;
  float roughness = 0.8F;
  bool double_sided = false;
  AlphaMode alpha_mode = AlphaMode::opaque;
  float alpha_cutoff = 0.5F;
  float normal_scale = 1.0F;                   // of the texture's x and y
  float occlusion_strength = 1.0F;             // 0: the texture is not felt
  MaterialTexture base_color_texture;          // colour and opacity
  MaterialTexture metallic_roughness_texture;  // green: roughness, blue: metallic
  MaterialTexture normal_texture;              // in the frame of Mesh::tangents
  MaterialTexture occlusion_texture;           // red: share of the ambient light
  MaterialTexture emissive_texture;            // colour

  // Whether it needs more than a colour and its texture.
  [[nodiscard]] bool has_maps() const {
    return metallic_roughness_texture.image >= 0 || normal_texture.image >= 0 ||
           occlusion_texture.image >= 0 || emissive_texture.image >= 0 ||
           base_color_texture.texcoords != 0 || alpha_mode != AlphaMode::opaque;
  }
};

// What the file calls a thing: a node of glTF with its mesh, an object or group of OBJ.
struct ModelNode {
  std::string name;
  std::string mesh;  // glTF: the mesh's name
  int parent = -1;   // index of an earlier node, or -1
};
// A run of a mesh's triangles that came from one node.
struct NodeFaces {
  std::uint32_t node = 0;       // index into Model::nodes
  std::size_t first_index = 0;  // into Mesh::indices
  std::size_t index_count = 0;
};

// One draw: an indexed triangle list with one material.
struct Mesh {
  std::string name;                  // of the first of the file's meshes that are in it
  std::vector<glm::vec3> positions;  // [m]
  std::vector<glm::vec3> normals;    // unit, one per position
  std::vector<glm::vec2> texcoords;  // one per position, or empty; (0, 0) at the texture's top left
  std::vector<glm::vec2> texcoords_2;  // the same, for textures that are laid out in another way
  // Of the normal texture, one per position, or empty: xyz unit, where its x points; its y points
  // to cross(normal, tangent) * w.
  std::vector<glm::vec4> tangents;
  std::vector<glm::vec4> colors;  // linear, one per position, or empty
  std::vector<std::uint32_t> indices;
  // Which vertex of the model file each vertex came from (for OBJ: the index of its `v` line; for
  // glTF: counted through the primitives' POSITION accessors in the order of the file). Kernel
  // files speak of these.
  std::vector<std::uint32_t> source_vertex;
  std::vector<NodeFaces> node_faces;  // in order; empty where the maker has no names
  // Shadow kernels that came with the model, one per position [m], or empty.
  std::vector<glm::vec3> shadow_kernels;
  int material = 0;
};

struct Model {
  std::string name;
  std::vector<Mesh> meshes;
  std::vector<Material> materials;
  std::vector<Texture> textures;
  std::vector<ModelNode> nodes;  // those with faces, and their ancestors
  // Place of the file's coordinates that all positions, kernels and bounds are relative to [m],
  // object frame. Zero but for a model that lies far from its file's origin for its size: there
  // floats would lose its shape. placed_model() (scene.hpp) adds it.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  glm::vec3 min_corner{0.0F};  // bounds over all meshes
  glm::vec3 max_corner{0.0F};
  std::uint32_t source_vertex_count = 0;
  // The up direction (unit) that Mesh::shadow_kernels were made for; absent where there are none.
  std::optional<glm::vec3> shadow_kernel_up;
  std::string shadow_kernel_geometry;  // what they were made for (kernel_stamp.hpp); may be ""
  // The groups of parts (part_groups.hpp) that share one light where nobody names others: those
  // that the kernels were stored for.
  std::vector<std::string> shadow_kernel_groups;
  // The format says that faces of materials that are not double-sided are seen from in front alone:
  // from where their corners turn anticlockwise.
  bool culls_back_faces = false;
  std::vector<std::string> warnings;  // what was left out of the file, and why

  [[nodiscard]] std::size_t vertex_count() const;
  [[nodiscard]] std::size_t triangle_count() const;
};

enum class UpAxis {
  by_format,
  y,
  z
};  // by_format: glTF is y up and is turned (x, y, z) -> (x, -z, y); OBJ is taken as z up

struct ModelLimits {
  std::size_t max_file_bytes = std::size_t{512} << 20U;
  std::size_t max_vertices = 20'000'000;
  std::size_t max_triangles = 20'000'000;
  std::size_t max_texture_pixels = std::size_t{64} << 20U;
  double max_coordinate_m = 1e6;  // from Model::origin
  std::size_t max_meshes = 4096;  // one draw each
};

// How a model file is read.
struct ModelReading {
  UpAxis up = UpAxis::by_format;
  double unit_m = 1.0;         // length of the file's unit [m]; glTF's is the metre
  bool stored_kernels = true;  // whether to read the shadow kernels of the file
  ModelLimits limits = {};
};

// .glb, .gltf, .obj. Whatever the reader returns is checked: finite numbers, index ranges,
// accessors inside their buffers, counts and sizes; external files only beside the model. Errors
// name the file and the cause. No input makes it crash.
[[nodiscard]] Result<Model> load_model(const std::filesystem::path& file,
                                       const ModelReading& reading = {});

// Makes everything in the model relative to `origin`; it stays where it is.
void move_origin(Model& model, const Eigen::Vector3d& origin);

// A hash of what shadow kernels depend on: every mesh's positions and faces. Tells that a model has
// changed since its kernels were stored.
[[nodiscard]] std::string geometry_key(const Model& model);

// The same surface with no edge longer than `max_edge_m`, so that straight edges can follow a
// curved lens when drawn. Splits at most `max_triangles`; what is left over stays long.
[[nodiscard]] Mesh subdivided(const Mesh& mesh, float max_edge_m,
                              std::size_t max_triangles = 500'000);

}  // namespace penumbra
