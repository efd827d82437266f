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
#include "tools/models/animated_models.hpp"

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

int add_floats(tinygltf::Model& file, const std::vector<float>& values, int type) {
  const int components = tinygltf::GetNumComponentsInType(static_cast<std::uint32_t>(type));
  const int accessor = add_accessor(file, add_view(file, values, 0), TINYGLTF_COMPONENT_TYPE_FLOAT,
                                    type, values.size() / static_cast<std::size_t>(components));
  return accessor;
}

// Adds a node, mesh and primitives for each name.
tinygltf::Model document_of(const Model& model) {
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
  return file;
}

Result<std::vector<std::uint8_t>> bytes_of(const tinygltf::Model& file, const std::string& name) {
  std::ostringstream stream;
  tinygltf::TinyGLTF writer;
  try {
    if (!writer.WriteGltfSceneToStream(&file, stream, false, true))
      return fail("{}.glb: could not be encoded", name);
  } catch (const std::exception& e) {
    return fail("{}.glb: could not be encoded: {}", name, e.what());
  }
  const std::string bytes = stream.str();
  return std::vector<std::uint8_t>(bytes.begin(), bytes.end());
}

// Returns the primitives in the order of the model's meshes.
std::vector<tinygltf::Primitive*> primitives_of(tinygltf::Model& file) {
  std::vector<tinygltf::Primitive*> primitives;
  for (tinygltf::Mesh& mesh : file.meshes)
    for (tinygltf::Primitive& primitive : mesh.primitives) primitives.push_back(&primitive);
  return primitives;
}

glm::vec3 y_up(const glm::dvec3& z_up) {
  const glm::vec3 p(z_up);
  return {p.x, p.z, p.y == 0.0F ? 0.0F : -p.y};
}

// Adds the bones as nodes and moves every mesh by them. Returns the node of the first bone.
int add_skin(tinygltf::Model& file, const MovingModel& moving) {
  const int first = static_cast<int>(file.nodes.size());
  tinygltf::Skin skin;
  std::vector<float> inverse_bind;
  for (const Bone& bone : moving.bones) {
    const int node_index = static_cast<int>(file.nodes.size());
    const glm::dvec3 from = bone.parent < 0
                                ? glm::dvec3(0.0)
                                : moving.bones[static_cast<std::size_t>(bone.parent)].joint;
    const glm::vec3 offset = y_up(bone.joint - from);
    tinygltf::Node node;
    node.name = bone.name;
    for (int axis = 0; axis < 3; ++axis)
      node.translation.push_back(std::round(static_cast<double>(offset[axis]) * 1e3) * 1e-6);
    skin.joints.push_back(node_index);
    if (bone.parent >= 0) {
      file.nodes[static_cast<std::size_t>(first + bone.parent)].children.push_back(node_index);
    } else {
      file.scenes.front().nodes.push_back(node_index);
    }
    file.nodes.push_back(std::move(node));
    const glm::vec3 joint = 1e-3F * y_up(bone.joint);
    inverse_bind.insert(inverse_bind.end(), {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.0F - joint.x,
                                             0.0F - joint.y, 0.0F - joint.z, 1});
  }
  skin.inverseBindMatrices = add_floats(file, inverse_bind, TINYGLTF_TYPE_MAT4);
  file.skins.push_back(std::move(skin));
  for (tinygltf::Node& node : file.nodes)
    if (node.mesh >= 0) node.skin = 0;
  const std::vector<tinygltf::Primitive*> primitives = primitives_of(file);
  for (std::size_t m = 0; m < primitives.size(); ++m) {
    std::vector<std::array<std::uint8_t, 4>> bones;
    std::vector<std::array<float, 4>> weights;
    for (const BoneWeights& of_vertex : moving.skin[m]) {
      bones.push_back(of_vertex.bones);
      weights.push_back(of_vertex.weights);
    }
    primitives[m]->attributes["JOINTS_0"] =
        add_accessor(file, add_view(file, bones, TINYGLTF_TARGET_ARRAY_BUFFER),
                     TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE, TINYGLTF_TYPE_VEC4, bones.size());
    primitives[m]->attributes["WEIGHTS_0"] =
        add_accessor(file, add_view(file, weights, TINYGLTF_TARGET_ARRAY_BUFFER),
                     TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC4, weights.size());
  }
  return first;
}

void add_targets(tinygltf::Model& file, const MovingModel& moving) {
  const std::vector<tinygltf::Primitive*> primitives = primitives_of(file);
  for (std::size_t m = 0; m < primitives.size(); ++m) {
    const Mesh& base = moving.model.meshes[m];
    for (const Model& target : moving.targets) {
      const Mesh& displaced = target.meshes[m];
      PENUMBRA_ASSERT(displaced.indices == base.indices);
      std::vector<glm::vec3> positions, normals;
      for (std::size_t i = 0; i < base.positions.size(); ++i) {
        positions.push_back(displaced.positions[i] - base.positions[i]);
        normals.push_back(displaced.normals[i] - base.normals[i]);
      }
      const auto deltas = y_up(normals);
      primitives[m]->targets.push_back(
          {{"POSITION", add_positions(file, positions)},
           {"NORMAL",
            add_accessor(file, add_view(file, deltas, TINYGLTF_TARGET_ARRAY_BUFFER),
                         TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, deltas.size())}});
    }
  }
  for (tinygltf::Mesh& mesh : file.meshes) mesh.weights.assign(moving.targets.size(), 0.0);
}

void add_motion(tinygltf::Model& file, const Motion& motion, int first_bone) {
  tinygltf::Animation animation;
  animation.name = motion.name;
  const std::size_t keys = std::max(motion.rotations.size(), motion.weights.size());
  std::vector<float> times;
  float last = 0.0F;
  for (std::size_t key = 0; key < keys; ++key) {
    last = static_cast<float>(motion.duration_s * static_cast<double>(key) /
                              static_cast<double>(keys - 1));
    times.push_back(last);
  }
  const int input = add_floats(file, times, TINYGLTF_TYPE_SCALAR);
  file.accessors.back().minValues = {0.0};
  file.accessors.back().maxValues = {static_cast<double>(last)};
  const auto add_channel = [&](int node, const char* path, int output) {
    tinygltf::AnimationSampler sampler;
    sampler.input = input;
    sampler.output = output;
    sampler.interpolation = "LINEAR";
    tinygltf::AnimationChannel channel;
    channel.sampler = static_cast<int>(animation.samplers.size());
    channel.target_node = node;
    channel.target_path = path;
    animation.samplers.push_back(std::move(sampler));
    animation.channels.push_back(std::move(channel));
  };
  const auto rounded = [](double value) {
    const double r = std::round(value * 1e5) / 1e5;
    return static_cast<float>(r == 0.0 ? 0.0 : r);
  };
  if (!motion.root_offsets.empty()) {
    const std::vector<double> rest = file.nodes[static_cast<std::size_t>(first_bone)].translation;
    std::vector<float> values;
    for (const glm::dvec3& offset : motion.root_offsets) {
      const glm::vec3 o = y_up(offset);
      for (int axis = 0; axis < 3; ++axis)
        values.push_back(
            static_cast<float>(rest[static_cast<std::size_t>(axis)] +
                               1e-3 * static_cast<double>(rounded(static_cast<double>(o[axis])))));
    }
    add_channel(first_bone, "translation", add_floats(file, values, TINYGLTF_TYPE_VEC3));
  }
  for (std::size_t bone = 0; !motion.rotations.empty() && bone < motion.rotations.front().size();
       ++bone) {
    std::vector<float> values;
    for (const auto& turns : motion.rotations) {
      const glm::dquat& q = turns[bone];
      for (const double v : {q.x, q.z, -q.y, q.w}) values.push_back(rounded(v));
    }
    add_channel(first_bone + static_cast<int>(bone), "rotation",
                add_floats(file, values, TINYGLTF_TYPE_VEC4));
  }
  for (std::size_t n = 0; !motion.weights.empty() && n < file.nodes.size(); ++n) {
    if (file.nodes[n].mesh < 0) continue;
    std::vector<float> values;
    for (const auto& weights : motion.weights)
      for (const double w : weights) values.push_back(rounded(w));
    add_channel(static_cast<int>(n), "weights", add_floats(file, values, TINYGLTF_TYPE_SCALAR));
  }
  file.animations.push_back(std::move(animation));
}

}  // namespace

Result<std::vector<std::uint8_t>> encode_glb(const Model& model) {
  return bytes_of(document_of(model), model.name);
}

Result<std::vector<std::uint8_t>> encode_glb(const MovingModel& moving) {
  tinygltf::Model file = document_of(moving.model);
  const int first_bone = moving.bones.empty() ? -1 : add_skin(file, moving);
  if (!moving.targets.empty()) add_targets(file, moving);
  add_motion(file, moving.motion, first_bone);
  return bytes_of(file, moving.model.name);
}

}  // namespace penumbra::models
