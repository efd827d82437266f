#include "tools/models/glb_writer.hpp"

#include <tiny_gltf.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <exception>
#include <limits>
#include <sstream>

#include "core/assert.hpp"

namespace penumbra::models {
namespace {

// Buffers are written in the machine's byte order, which must be little-endian.
template <class T>
int add_view(tinygltf::Model& file, const std::vector<T>& data, int target) {
  std::vector<unsigned char>& bytes = file.buffers.front().data;
  bytes.resize((bytes.size() + 3) / 4 * 4);
  tinygltf::BufferView view;
  view.buffer = 0;
  view.byteOffset = bytes.size();
  view.byteLength = data.size() * sizeof(T);
  view.target = target;
  bytes.resize(view.byteOffset + view.byteLength);
  std::memcpy(bytes.data() + view.byteOffset, data.data(), view.byteLength);
  file.bufferViews.push_back(std::move(view));
  return static_cast<int>(file.bufferViews.size() - 1);
}

int add_accessor(tinygltf::Model& file, int view, int component, int type, std::size_t count) {
  tinygltf::Accessor accessor;
  accessor.bufferView = view;
  accessor.componentType = component;
  accessor.type = type;
  accessor.count = count;
  file.accessors.push_back(std::move(accessor));
  return static_cast<int>(file.accessors.size() - 1);
}

std::vector<std::array<float, 3>> y_up(const std::vector<glm::vec3>& z_up) {
  std::vector<std::array<float, 3>> turned;
  turned.reserve(z_up.size());
  for (const glm::vec3& v : z_up) turned.push_back({v.x, v.z, v.y == 0.0F ? 0.0F : -v.y});
  return turned;
}

int add_positions(tinygltf::Model& file, const std::vector<glm::vec3>& positions) {
  const auto points = y_up(positions);
  const int accessor =
      add_accessor(file, add_view(file, points, TINYGLTF_TARGET_ARRAY_BUFFER),
                   TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, points.size());
  std::vector<double> low(3, std::numeric_limits<double>::infinity());
  std::vector<double> high(3, -std::numeric_limits<double>::infinity());
  for (const auto& p : points) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], static_cast<double>(p[axis]));
      high[axis] = std::max(high[axis], static_cast<double>(p[axis]));
    }
  }
  file.accessors.back().minValues = std::move(low);
  file.accessors.back().maxValues = std::move(high);
  return accessor;
}

int add_indices(tinygltf::Model& file, const Mesh& mesh) {
  constexpr int kTarget = TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER;
  if (mesh.positions.size() < std::numeric_limits<std::uint16_t>::max()) {
    const std::vector<std::uint16_t> narrow(mesh.indices.begin(), mesh.indices.end());
    return add_accessor(file, add_view(file, narrow, kTarget),
                        TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT, TINYGLTF_TYPE_SCALAR,
                        narrow.size());
  }
  return add_accessor(file, add_view(file, mesh.indices, kTarget),
                      TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR,
                      mesh.indices.size());
}

// Rounds a colour to the few digits with which it was chosen.
double short_number(float value) {
  return std::round(static_cast<double>(value) * 1e4) / 1e4;
}

tinygltf::Material material_of(const Material& material) {
  tinygltf::Material out;
  out.name = material.name;
  const glm::vec4& c = material.base_color;
  out.pbrMetallicRoughness.baseColorFactor = {short_number(c.r), short_number(c.g),
                                              short_number(c.b), short_number(c.a)};
  out.pbrMetallicRoughness.metallicFactor = short_number(material.metallic);
  out.pbrMetallicRoughness.roughnessFactor = short_number(material.roughness);
  const glm::vec3& e = material.emissive;
  out.emissiveFactor = {short_number(e.r), short_number(e.g), short_number(e.b)};
  out.doubleSided = material.double_sided;
  return out;
}

}  // namespace

Result<std::vector<std::uint8_t>> encode_glb(const Model& model) {
  tinygltf::Model file;
  file.asset.version = "2.0";
  file.asset.generator = "penumbra make_models";
  file.buffers.emplace_back();
  tinygltf::Scene scene;
  scene.name = model.name;
  for (const Mesh& mesh : model.meshes) {
    PENUMBRA_ASSERT(mesh.texcoords.empty() && mesh.colors.empty() && !mesh.indices.empty());
    if (file.meshes.empty() || file.meshes.back().name != mesh.name) {
      tinygltf::Node node;
      node.name = mesh.name;
      node.mesh = static_cast<int>(file.meshes.size());
      scene.nodes.push_back(static_cast<int>(file.nodes.size()));
      file.nodes.push_back(std::move(node));
      file.meshes.emplace_back();
      file.meshes.back().name = mesh.name;
    }
    tinygltf::Primitive primitive;
    primitive.mode = TINYGLTF_MODE_TRIANGLES;
    primitive.material = mesh.material;
    primitive.attributes["POSITION"] = add_positions(file, mesh.positions);
    const auto normals = y_up(mesh.normals);
    primitive.attributes["NORMAL"] =
        add_accessor(file, add_view(file, normals, TINYGLTF_TARGET_ARRAY_BUFFER),
                     TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, normals.size());
    primitive.indices = add_indices(file, mesh);
    file.meshes.back().primitives.push_back(std::move(primitive));
  }
  for (const Material& material : model.materials) file.materials.push_back(material_of(material));
  file.scenes.push_back(std::move(scene));
  file.defaultScene = 0;

  std::ostringstream stream;
  tinygltf::TinyGLTF writer;
  try {
    if (!writer.WriteGltfSceneToStream(&file, stream, false, true))
      return fail("{}.glb: could not be encoded", model.name);
  } catch (const std::exception& e) {
    return fail("{}.glb: could not be encoded: {}", model.name, e.what());
  }
  const std::string bytes = stream.str();
  return std::vector<std::uint8_t>(bytes.begin(), bytes.end());
}

}  // namespace penumbra::models
