// Decodes primitives compressed with KHR_draco_mesh_compression.
#pragma once

#include <tiny_gltf.h>

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/accessors.hpp"
#include "render/model/model.hpp"

namespace draco {
class Mesh;
}

namespace penumbra::gltf {

class DracoMeshes {
 public:
  DracoMeshes(Accessors& accessors, const ModelLimits& limits)
      : accessors_(accessors), limits_(limits) {}

  // Returns true if the primitive has this attribute, or its indices, only in compressed form.
  // Uncompressed data is preferred, because it is exact.
  [[nodiscard]] bool has(const tinygltf::Primitive& primitive, const std::string& key) const;
  // Returns an attribute for which has() is true. `what`: JSON path of the primitive.
  [[nodiscard]] Result<Elements> attribute(const tinygltf::Primitive& primitive,
                                           const std::string& key, const Shape& shape,
                                           const std::string& what);
  // Returns the corners of the triangles, three each. Requires has(primitive, kIndicesKey).
  [[nodiscard]] Result<std::vector<std::uint32_t>> corners(const tinygltf::Primitive& primitive,
                                                           const std::string& what);

 private:
  [[nodiscard]] bool is_used(const tinygltf::Primitive& primitive) const;
  [[nodiscard]] Result<const draco::Mesh*> decoded(const tinygltf::Primitive& primitive,
                                                   const std::string& what);

  Accessors& accessors_;
  const ModelLimits& limits_;
  // By buffer view: the attributes of a primitive are read at different times.
  std::map<int, std::shared_ptr<const draco::Mesh>> meshes_;
};

}  // namespace penumbra::gltf
