#include "render/model/gltf/meshes.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/propagate.hpp"

namespace penumbra::gltf {
namespace {

glm::vec3 vector_at(const Elements& from, std::size_t i) {
  return {static_cast<float>(from.at(i, 0)), static_cast<float>(from.at(i, 1)),
          static_cast<float>(from.at(i, 2))};
}

std::vector<glm::vec3> vectors(const Elements& from) {
  std::vector<glm::vec3> result;
  result.reserve(from.count);
  for (std::size_t i = 0; i < from.count; ++i) result.push_back(vector_at(from, i));
  return result;
}

int mode_of(const tinygltf::Primitive& primitive) {
  return primitive.mode < 0 ? TINYGLTF_MODE_TRIANGLES : primitive.mode;
}

// Converts a list, strip or fan of triangles to a list.
std::vector<std::uint32_t> as_list(const std::vector<std::uint32_t>& order, int mode) {
  std::vector<std::uint32_t> result;
  const bool is_list = mode == TINYGLTF_MODE_TRIANGLES;
  for (std::size_t i = 0; i + 2 < order.size(); i += is_list ? 3 : 1) {
    const std::uint32_t a = order[mode == TINYGLTF_MODE_TRIANGLE_FAN ? 0 : i];
    std::uint32_t b = order[i + 1];
    std::uint32_t c = order[i + 2];
    if (mode == TINYGLTF_MODE_TRIANGLE_STRIP && i % 2 == 1) std::swap(b, c);
    // Keeps degenerate triangles of a list; in strips they only connect other triangles.
    if (is_list || (a != b && b != c && c != a)) result.insert(result.end(), {a, b, c});
  }
  return result;
}

}  // namespace

bool has_surface(const tinygltf::Primitive& primitive) {
  return primitive.attributes.contains("POSITION") && mode_of(primitive) >= TINYGLTF_MODE_TRIANGLES;
}

Result<void> check_joints(const Primitive& primitive, std::size_t joint_count) {
  const SkinWeights& skin = primitive.skin;
  for (std::size_t k = 0; k < skin.joints.size(); ++k) {
    // Ignores joints with a weight of 0.
    if (skin.joints[k] >= joint_count && skin.weights[k] > 0.0) {
      return fail("{}/attributes/JOINTS_{}: vertex {} names joint {}, the skin has {}",
                  primitive.json_path, k % skin.per_vertex / 4, k / skin.per_vertex, skin.joints[k],
                  joint_count);
    }
  }
  return {};
}

Eigen::Matrix4d SkinWeights::blended(std::size_t vertex,
                                     const std::vector<Eigen::Matrix4d>& joint_matrices) const {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  for (std::size_t k = vertex * per_vertex; k < (vertex + 1) * per_vertex; ++k) {
    if (weights[k] > 0.0) sum += weights[k] * joint_matrices[joints[k]];
  }
  return sum;
}

Result<Elements> MeshReader::attribute(const tinygltf::Primitive& from, const std::string& key,
                                       const Shape& shape, const std::string& what) {
  if (draco_.has(from, key)) return draco_.attribute(from, key, shape, what);
  return accessors_.attribute(from.attributes, key, shape, what + "/attributes");
}

// Returns the corners' vertices in the order of the file.
Result<std::vector<std::uint32_t>> MeshReader::corners(const tinygltf::Primitive& from,
                                                       std::size_t vertices,
                                                       const std::string& what) {
  std::vector<std::uint32_t> order;
  const auto entry = from.attributes.find(kIndicesKey);
  if (entry == from.attributes.end()) {
    order.resize(vertices);
    std::iota(order.begin(), order.end(), 0U);
    return order;
  }
  const std::string json_path = what + "/indices";
  PENUMBRA_TRY(const Elements indices, accessors_.elements(entry->second, json_path));
  const tinygltf::Accessor* accessor = accessors_.find(entry->second);
  if (indices.width != 1 || !is_unsigned(accessor->componentType) || accessor->normalized) {
    return fail("{}: are not unsigned integers", json_path);
  }
  order.reserve(indices.count);
  for (const double index : indices.values) {
    if (!(index < static_cast<double>(vertices))) {
      return fail("{}: names vertex {}, there are {}", json_path, index, vertices);
    }
    order.push_back(static_cast<std::uint32_t>(index));
  }
  return order;
}

// Returns the indices of a triangle list, converted from strips and fans.
Result<std::vector<std::uint32_t>> MeshReader::triangles(const tinygltf::Primitive& from,
                                                         std::size_t vertices,
                                                         const std::string& what) {
  int mode = mode_of(from);
  if (mode > TINYGLTF_MODE_TRIANGLE_FAN) {
    return fail("{}/mode: {} is none of glTF's values", what, mode);
  }
  std::vector<std::uint32_t> order;
  if (draco_.has(from, kIndicesKey)) {
    mode = TINYGLTF_MODE_TRIANGLES;  // Draco's data has no strips
    PENUMBRA_TRY(order, draco_.corners(from, what));
  } else {
    PENUMBRA_TRY(order, corners(from, vertices, what));
  }
  if (mode == TINYGLTF_MODE_TRIANGLES && order.size() % 3 != 0) {
    return fail("{}: has {} indices, not a multiple of 3", what, order.size());
  }
  std::vector<std::uint32_t> result = as_list(order, mode);
  if (result.size() / 3 > limits_.max_triangles) {
    return fail("{}: has {} triangles, more than the {} allowed", what, result.size() / 3,
                limits_.max_triangles);
  }
  return result;
}

Result<void> MeshReader::read_texcoords(const tinygltf::Primitive& from, const std::string& what,
                                        Mesh& mesh) {
  std::vector<TextureLayout> layouts = materials_.layouts(static_cast<std::size_t>(mesh.material));
  const bool textured = !layouts.empty();
  if (!textured) layouts.emplace_back();
  for (std::size_t s = 0; s < layouts.size(); ++s) {
    const std::string key = fmt::format("TEXCOORD_{}", layouts[s].set);
    PENUMBRA_TRY(const Elements read, attribute(from, key, {2, 2, mesh.positions.size()}, what));
    if (textured && read.count == 0)
      notes_.add("has no " + key + ", which its textures need; they are drawn in one colour", what);
    std::vector<glm::vec2>& to = s == 0 ? mesh.texcoords : mesh.texcoords_2;
    for (std::size_t i = 0; i < read.count; ++i)
      to.push_back(layouts[s].apply({read.at(i, 0), read.at(i, 1)}));
  }
  return {};
}

// Reads all attributes except positions.
Result<void> MeshReader::read_attributes(const tinygltf::Primitive& from, const std::string& what,
                                         Mesh& mesh) {
  const std::size_t count = mesh.positions.size();
  const auto read = [&](const char* key, std::size_t min_width, std::size_t max_width) {
    return attribute(from, key, {min_width, max_width, count}, what);
  };
  PENUMBRA_TRY(const Elements normals, read("NORMAL", 3, 3));
  PENUMBRA_TRY(const Elements colors, read("COLOR_0", 3, 4));
  PENUMBRA_TRY(const Elements kernels, read("_SHADOW_KERNEL", 3, 3));
  PENUMBRA_TRY_VOID(read_texcoords(from, what, mesh));
  mesh.normals = vectors(normals);
  mesh.shadow_kernels = vectors(kernels);
  const auto number = [](const Elements& elements, std::size_t i, std::size_t c) {
    return static_cast<float>(elements.at(i, c));
  };
  for (std::size_t i = 0; i < colors.count; ++i) {
    mesh.colors.emplace_back(vector_at(colors, i), colors.width == 4 ? number(colors, i, 3) : 1.0F);
  }
  const Material& material = model_.materials[static_cast<std::size_t>(mesh.material)];
  if (material.normal_texture.image < 0) return {};
  // The file's tangents are for the untransformed coordinates. place_all() computes others.
  const auto& layouts = materials_.layouts(static_cast<std::size_t>(mesh.material));
  if (!layouts[static_cast<std::size_t>(material.normal_texture.texcoords)].keeps_directions())
    return {};
  PENUMBRA_TRY(const Elements tangents, read("TANGENT", 4, 4));
  for (std::size_t i = 0; i < tangents.count; ++i) {
    mesh.tangents.emplace_back(vector_at(tangents, i), number(tangents, i, 3));
  }
  return {};
}

Result<void> MeshReader::read_targets(const tinygltf::Primitive& from, Primitive& to) {
  for (std::size_t t = 0; t < from.targets.size(); ++t) {
    const std::string json_path = fmt::format("{}/targets/{}", to.json_path, t);
    MorphTarget target;
    const auto read = [&](const char* key) -> Result<std::vector<glm::vec3>> {
      return accessors_.attribute(from.targets[t], key, {3, 3, to.mesh.positions.size()}, json_path)
          .map(vectors);
    };
    PENUMBRA_TRY(target.positions, read("POSITION"));
    PENUMBRA_TRY(target.normals, read("NORMAL"));
    PENUMBRA_TRY(target.tangents, read("TANGENT"));
    morph_vectors_ += target.positions.size() + target.normals.size() + target.tangents.size();
    if (morph_vectors_ > limits_.max_morph_vectors) {
      return fail(
          "{}: the morph targets up to here have more than {} vectors; export fewer targets",
          json_path, limits_.max_morph_vectors);
    }
    for (const auto& [key, accessor] : from.targets[t]) {
      if (key.starts_with("TEXCOORD_") || key.starts_with("COLOR_")) {
        notes_.add("its texture coordinates and colours are not morphed", json_path);
        break;
      }
    }
    to.targets.push_back(std::move(target));
  }
  return {};
}

// Reads JOINTS_0, WEIGHTS_0 and the following sets.
Result<SkinWeights> MeshReader::read_skin_weights(const tinygltf::Primitive& from,
                                                  const Primitive& to) {
  const std::size_t count = to.mesh.positions.size();
  const std::string json_path = to.json_path + "/attributes";
  std::vector<Elements> joints, weights;
  for (int set = 0;; ++set) {
    const std::string joints_key = fmt::format("JOINTS_{}", set);
    const std::string weights_key = fmt::format("WEIGHTS_{}", set);
    const auto joints_entry = from.attributes.find(joints_key);
    const auto weights_entry = from.attributes.find(weights_key);
    const bool has_joints = joints_entry != from.attributes.end();
    if (has_joints != (weights_entry != from.attributes.end())) {
      return fail("{}: has {} without {}", json_path, has_joints ? joints_key : weights_key,
                  has_joints ? weights_key : joints_key);
    }
    if (!has_joints) break;
    PENUMBRA_TRY(Elements j, attribute(from, joints_key, {4, 4, count}, to.json_path));
    PENUMBRA_TRY(Elements w, attribute(from, weights_key, {4, 4, count}, to.json_path));
    const tinygltf::Accessor* joint_type = accessors_.find(joints_entry->second);
    const tinygltf::Accessor* weight_type = accessors_.find(weights_entry->second);
    if (!is_unsigned(joint_type->componentType) || joint_type->normalized) {
      return fail("{}/{}: are not unsigned integers", json_path, joints_key);
    }
    if (weight_type->componentType != TINYGLTF_COMPONENT_TYPE_FLOAT &&
        !(is_unsigned(weight_type->componentType) && weight_type->normalized)) {
      return fail("{}/{}: are neither floats nor normalized unsigned integers", json_path,
                  weights_key);
    }
    joints.push_back(std::move(j));
    weights.push_back(std::move(w));
  }
  SkinWeights skin{4 * joints.size(), {}, {}};
  bool far_off = false, weightless = false;
  for (std::size_t i = 0; i < count && skin.per_vertex > 0; ++i) {
    const std::size_t first = skin.weights.size();
    double sum = 0.0;
    for (std::size_t set = 0; set < joints.size(); ++set) {
      for (std::size_t c = 0; c < 4; ++c) {
        const double weight = weights[set].at(i, c);
        if (weight < 0.0) {
          return fail("{}/WEIGHTS_{}: vertex {} has a weight of {}; export the model again",
                      json_path, set, i, weight);
        }
        sum += weight;
        skin.weights.push_back(weight);
        skin.joints.push_back(static_cast<std::uint32_t>(joints[set].at(i, c)));
      }
    }
    // The sum of eight 8-bit weights may differ from 1 by 8 * 0.5 / 255.
    far_off = far_off || std::abs(sum - 1.0) > 0.02;
    if (!(sum > 0.0)) {
      weightless = true;
      skin.weights[first] = sum = 1.0;
    }
    for (std::size_t k = first; k < skin.weights.size(); ++k) skin.weights[k] /= sum;
  }
  if (weightless) {
    notes_.add("has vertices without weights; they follow the first joint that they name",
               json_path);
  } else if (far_off) {
    notes_.add("has skin weights that do not add up to 1; they are scaled to do so", json_path);
  }
  return skin;
}

Result<Primitive> MeshReader::read_primitive(const tinygltf::Primitive& from,
                                             const std::string& what, std::uint32_t first_vertex) {
  Primitive primitive{what, {}, {}, {}};
  Mesh& mesh = primitive.mesh;
  PENUMBRA_TRY(const Elements positions, attribute(from, "POSITION", {3, 3, 0}, what));
  if (positions.count > limits_.max_vertices) {
    return fail("{}: has {} vertices, more than the {} allowed", what, positions.count,
                limits_.max_vertices);
  }
  mesh.positions = vectors(positions);
  for (std::size_t i = 0; i < positions.count; ++i) {
    mesh.source_vertex.push_back(first_vertex + static_cast<std::uint32_t>(i));
  }
  const auto materials = static_cast<int>(gltf_.materials.size());
  if (from.material >= materials) {
    return fail("{}: names material {}, there are {}", what, from.material, materials);
  }
  mesh.material = from.material < 0 ? materials : from.material;
  PENUMBRA_TRY_VOID(read_attributes(from, what, mesh));
  PENUMBRA_TRY(mesh.indices, triangles(from, positions.count, what));
  PENUMBRA_TRY_VOID(read_targets(from, primitive));
  return primitive;
}

Result<void> MeshReader::number_vertices() {
  std::size_t vertices = 0;
  for (std::size_t m = 0; m < gltf_.meshes.size(); ++m) {
    for (const tinygltf::Primitive& primitive : gltf_.meshes[m].primitives) {
      meshes_[m].first_vertex.push_back(static_cast<std::uint32_t>(vertices));
      const auto positions = primitive.attributes.find("POSITION");
      if (positions == primitive.attributes.end()) continue;
      const tinygltf::Accessor* accessor = accessors_.find(positions->second);
      if (accessor == nullptr) continue;
      if (accessor->count > limits_.max_vertices - vertices) {
        return fail("has more than the {} vertices allowed", limits_.max_vertices);
      }
      vertices += accessor->count;
      meshes_[m].vertex_count += static_cast<std::uint32_t>(accessor->count);
    }
  }
  model_.source_vertex_count = static_cast<std::uint32_t>(vertices);
  return {};
}

Result<std::uint32_t> MeshReader::source_shift_of_next_use(int mesh) {
  Entry& entry = meshes_[static_cast<std::size_t>(mesh)];
  if (!entry.is_used || entry.first_vertex.empty()) {
    entry.is_used = true;
    return 0U;
  }
  const std::uint32_t shift = model_.source_vertex_count - entry.first_vertex.front();
  const std::size_t count = std::size_t{model_.source_vertex_count} + entry.vertex_count;
  if (count > limits_.max_vertices) {
    return fail("has more than the {} vertices allowed", limits_.max_vertices);
  }
  model_.source_vertex_count = static_cast<std::uint32_t>(count);
  return shift;
}

Result<void> MeshReader::read_mesh(std::size_t index, Entry& entry) {
  const tinygltf::Mesh& from = gltf_.meshes[index];
  std::vector<Primitive>& primitives = entry.primitives.emplace();
  for (std::size_t p = 0; p < from.primitives.size(); ++p) {
    const std::string json_path = fmt::format("meshes/{}/primitives/{}", index, p);
    const tinygltf::Primitive& primitive = from.primitives[p];
    if (!primitive.attributes.contains("POSITION")) {
      notes_.add("has no POSITION attribute and is ignored", json_path);
      continue;
    }
    if (!has_surface(primitive)) {
      notes_.add("draws points or lines, which have no surface, and is ignored", json_path);
      continue;
    }
    PENUMBRA_TRY(Primitive read, read_primitive(primitive, json_path, entry.first_vertex[p]));
    read.mesh.name = from.name;
    read.index = p;
    primitives.push_back(std::move(read));
  }
  return {};
}

Result<const std::vector<Primitive>*> MeshReader::mesh(int index, bool skinned) {
  const auto m = static_cast<std::size_t>(index);
  Entry& entry = meshes_[m];
  if (!entry.primitives) PENUMBRA_TRY_VOID(read_mesh(m, entry));
  if (skinned && !entry.has_skin_weights) {
    entry.has_skin_weights = true;
    std::size_t next = 0;
    for (const tinygltf::Primitive& from : gltf_.meshes[m].primitives) {
      if (!has_surface(from)) continue;
      Primitive& to = (*entry.primitives)[next++];
      PENUMBRA_TRY(to.skin, read_skin_weights(from, to));
    }
  }
  return &*entry.primitives;
}

}  // namespace penumbra::gltf
