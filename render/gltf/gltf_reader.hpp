// glTF 2.0 -> Model, in the file's own axes (y up). What tinygltf returns is not trusted: every
// index, range and number is checked. Internal to render/gltf.
#pragma once

#include <tiny_gltf.h>

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "core/error.hpp"
#include "render/model.hpp"

namespace penumbra {

template <class T>
[[nodiscard]] bool has(const std::vector<T>& list, int index) {
  return index >= 0 && static_cast<std::size_t>(index) < list.size();
}

// The numbers of an accessor: `count` elements of `width` components.
struct Elements {
  std::size_t count = 0;
  std::size_t width = 0;
  std::vector<double> values;

  [[nodiscard]] double at(std::size_t element, std::size_t component) const {
    return values[element * width + component];
  }
};

class GltfReader {
 public:
  GltfReader(std::string name, const tinygltf::Model& gltf, const ModelLimits& limits)
      : name_(std::move(name)), gltf_(gltf), limits_(limits) {}

  [[nodiscard]] Result<Model> read();

 private:
  // A stretch of a buffer, checked: `count` elements of `size` bytes, `stride` apart.
  struct Stretch {
    const std::uint8_t* data = nullptr;
    std::size_t stride = 0;
  };
  [[nodiscard]] Result<std::span<const std::uint8_t>> view_bytes(int view,
                                                                 const std::string& what) const;
  [[nodiscard]] Result<Stretch> stretch(int view, std::size_t offset, std::size_t count,
                                        std::size_t size, std::size_t alignment, bool strided,
                                        const std::string& what) const;
  [[nodiscard]] Result<Elements> elements(int accessor, const std::string& what) const;
  [[nodiscard]] Result<Elements> attribute(const tinygltf::Primitive& primitive,
                                           const std::string& key, std::size_t min_width,
                                           std::size_t max_width, std::size_t count,
                                           const std::string& what) const;
  [[nodiscard]] Result<std::vector<std::uint32_t>> triangles(const tinygltf::Primitive& primitive,
                                                             std::size_t vertices,
                                                             const std::string& what) const;
  [[nodiscard]] Result<void> read_materials();
  [[nodiscard]] Result<int> image(int index, const std::string& what);
  // `info`: one of tinygltf's kinds of texture reference.
  template <class Info>
  [[nodiscard]] Result<MaterialTexture> texture(const Info& info, const std::string& what,
                                                std::vector<int>& texcoord_sets);
  [[nodiscard]] Result<TextureSampling> sampling(int index) const;
  [[nodiscard]] Result<Mesh> read_primitive(const tinygltf::Primitive& primitive,
                                            const std::string& what);
  [[nodiscard]] Result<void> read_meshes();
  [[nodiscard]] Result<Eigen::Matrix4d> node_matrix(const tinygltf::Node& node,
                                                    const std::string& what) const;
  [[nodiscard]] Result<void> place_node(int index, const Eigen::Matrix4d& T_root_parent, int depth,
                                        int parent = -1);
  void take_kernel_extras(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                          const std::string& what);
  [[nodiscard]] Result<void> place_mesh(int mesh, const Eigen::Matrix4d& T_root_node,
                                        const std::string& what, std::uint32_t node);
  std::uint32_t add_node(const std::string& node, int mesh, int parent);

  std::string name_;
  const tinygltf::Model& gltf_;
  const ModelLimits& limits_;
  Model model_;
  std::vector<std::vector<Mesh>> meshes_;  // per glTF mesh its primitives, in the mesh's frame
  std::vector<bool> placed_;               // per node
  bool kernels_disagree_ = false;
  std::unordered_map<int, int> image_index_;     // glTF image -> Model::textures
  std::vector<std::vector<int>> texcoord_sets_;  // per material, those that its textures use
  std::unordered_map<int, std::size_t> mesh_of_material_;  // -> Model::meshes
  std::size_t placed_vertices_ = 0;                        // by the nodes so far
  std::size_t placed_triangles_ = 0;
};

}  // namespace penumbra
