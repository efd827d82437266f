// glTF files of one mesh, uncompressed and compressed with meshoptimizer or Draco.
#pragma once

#include <draco/compression/expert_encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#include <meshoptimizer.h>

#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "support/gltf_builder.hpp"

namespace penumbra::test {

// A wavy sheet of `columns` x `rows` vertices, which follow two joints.
struct Sheet {
  std::vector<float> positions, normals, texcoords, weights;
  std::vector<std::uint8_t> colors, joints;
  std::vector<std::uint16_t> indices;

  [[nodiscard]] std::size_t count() const { return texcoords.size() / 2; }
};

inline Sheet wavy_sheet(int columns = 9, int rows = 7) {
  Sheet sheet;
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < columns; ++x) {
      const float u = static_cast<float>(x) / static_cast<float>(columns - 1);
      const float v = static_cast<float>(y) / static_cast<float>(rows - 1);
      const float slope = -0.3F * std::sin(6.0F * u);
      const float length = std::sqrt(1.0F + slope * slope);
      sheet.positions.insert(sheet.positions.end(),
                             {0.1F * u, 0.005F * std::cos(6.0F * u), 0.1F * v});
      sheet.normals.insert(sheet.normals.end(), {-slope / length, 1.0F / length, 0.0F});
      sheet.texcoords.insert(sheet.texcoords.end(), {u, v});
      sheet.weights.insert(sheet.weights.end(), {0.75F, 0.25F, 0.0F, 0.0F});
      sheet.colors.insert(sheet.colors.end(), {static_cast<std::uint8_t>(255 * x / columns),
                                               static_cast<std::uint8_t>(20 * y), 90, 255});
      const auto joint = static_cast<std::uint8_t>(2 * x > columns ? 1 : 0);
      sheet.joints.insert(sheet.joints.end(), {joint, static_cast<std::uint8_t>(1 - joint), 0, 0});
    }
  }
  for (int y = 0; y + 1 < rows; ++y) {
    for (int x = 0; x + 1 < columns; ++x) {
      const int a = y * columns + x;
      for (const int corner : {a, a + columns, a + columns + 1, a, a + columns + 1, a + 1}) {
        sheet.indices.push_back(static_cast<std::uint16_t>(corner));
      }
    }
  }
  return sheet;
}

// Adds the nodes of a skinned mesh with these attributes.
inline void add_skinned_sheet(GltfBuilder& file, const nlohmann::json& attributes,
                              std::size_t indices) {
  file.json["meshes"] = {{{"primitives", {{{"attributes", attributes}, {"indices", indices}}}}}};
  file.json["nodes"] = {{{"mesh", 0}, {"skin", 0}},
                        {{"translation", {0, 0.01, 0}}, {"children", {2}}},
                        {{"translation", {0, 0.02, 0}}}};
  file.json["skins"] = {{{"joints", {1, 2}}}};
  file.json["scenes"] = {{{"nodes", {0, 1}}}};
}

inline GltfBuilder plain_gltf(const Sheet& sheet) {
  GltfBuilder file;
  const nlohmann::json attributes = {{"POSITION", file.accessor(sheet.positions, "VEC3")},
                                     {"NORMAL", file.accessor(sheet.normals, "VEC3")},
                                     {"TEXCOORD_0", file.accessor(sheet.texcoords, "VEC2")},
                                     {"COLOR_0", file.accessor(sheet.colors, "VEC4", true)},
                                     {"JOINTS_0", file.accessor(sheet.joints, "VEC4")},
                                     {"WEIGHTS_0", file.accessor(sheet.weights, "VEC4")}};
  add_skinned_sheet(file, attributes, file.accessor(sheet.indices, "SCALAR"));
  return file;
}

// --- meshoptimizer ---

struct MeshoptForm {
  std::string extension = "EXT_meshopt_compression";
  bool filters = false;            // OCTAHEDRAL normals, EXPONENTIAL texture coordinates
  bool index_sequence = false;     // mode INDICES instead of TRIANGLES
  bool fallback_is_first = false;  // the buffer without data is buffer 0 (only for .gltf)
};

// Compresses a file made by GltfBuilder with one accessor per buffer view.
class MeshoptWriter {
 public:
  MeshoptWriter(const GltfBuilder& plain, const MeshoptForm& form) : plain_(plain), form_(form) {
    meshopt_encodeVertexVersion(0);
    meshopt_encodeIndexVersion(1);
    result_.json = plain.json;
  }

  GltfBuilder write() {
    const nlohmann::json attributes = plain_.json["meshes"][0]["primitives"][0]["attributes"];
    for (std::size_t i = 0; i < plain_.json["accessors"].size(); ++i) {
      const nlohmann::json& view = plain_.json["bufferViews"][i];
      const char* data = plain_.binary.data() + view["byteOffset"].get<std::size_t>();
      const std::size_t count = plain_.json["accessors"][i]["count"];
      const std::size_t bytes = view["byteLength"];
      if (plain_.json["accessors"][i]["type"] == "SCALAR") {
        add_indices(i, reinterpret_cast<const std::uint16_t*>(data), count);
      } else if (form_.filters && attributes["NORMAL"] == i) {
        add_normals(i, reinterpret_cast<const float*>(data), count);
      } else if (form_.filters && attributes["TEXCOORD_0"] == i) {
        std::vector<std::uint32_t> coded(bytes / 4);
        const auto* values = reinterpret_cast<const float*>(data);
#if MESHOPTIMIZER_VERSION < 200
        meshopt_encodeFilterExp(coded.data(), count, bytes / count, 15, values);
#else
        meshopt_encodeFilterExp(coded.data(), count, bytes / count, 15, values,
                                meshopt_EncodeExpSharedVector);
#endif
        add_vertices(i, coded.data(), count, bytes / count, "EXPONENTIAL");
      } else {
        add_vertices(i, data, count, bytes / count, "NONE");
      }
    }
    nlohmann::json data = {{"byteLength", result_.binary.size()},
                           {"uri", "data:;base64," + base64(result_.binary)}};
    nlohmann::json fallback = {{"byteLength", fallback_bytes_},
                               {"extensions", {{form_.extension, {{"fallback", true}}}}}};
    if (form_.fallback_is_first) std::swap(data, fallback);
    result_.json["buffers"] = {data, fallback};
    result_.json["extensionsUsed"] = {form_.extension};
    result_.json["extensionsRequired"] = {form_.extension};
    return std::move(result_);
  }

 private:
  void add_normals(std::size_t accessor, const float* normals, std::size_t count) {
    std::vector<float> padded;
    for (std::size_t v = 0; v < count; ++v) {
      padded.insert(padded.end(), {normals[3 * v], normals[3 * v + 1], normals[3 * v + 2], 0.0F});
    }
    std::vector<std::int16_t> coded(4 * count);
    meshopt_encodeFilterOct(coded.data(), count, 8, 12, padded.data());
    add_vertices(accessor, coded.data(), count, 8, "OCTAHEDRAL");
    result_.json["bufferViews"][accessor]["byteStride"] = 8;
    result_.json["accessors"][accessor]["componentType"] = 5122;
    result_.json["accessors"][accessor]["normalized"] = true;
  }
  void add_vertices(std::size_t view, const void* data, std::size_t count, std::size_t stride,
                    const std::string& filter) {
    std::vector<unsigned char> coded(meshopt_encodeVertexBufferBound(count, stride));
    coded.resize(meshopt_encodeVertexBuffer(coded.data(), coded.size(), data, count, stride));
    add_view(view, coded, count, stride, "ATTRIBUTES");
    if (filter != "NONE") {
      result_.json["bufferViews"][view]["extensions"][form_.extension]["filter"] = filter;
    }
  }
  void add_indices(std::size_t view, const std::uint16_t* indices, std::size_t count) {
    const std::vector<unsigned> wide(indices, indices + count);
    std::vector<unsigned char> coded(meshopt_encodeIndexBufferBound(count, 65536) +
                                     meshopt_encodeIndexSequenceBound(count, 65536));
    coded.resize(
        form_.index_sequence
            ? meshopt_encodeIndexSequence(coded.data(), coded.size(), wide.data(), wide.size())
            : meshopt_encodeIndexBuffer(coded.data(), coded.size(), wide.data(), wide.size()));
    add_view(view, coded, count, 2, form_.index_sequence ? "INDICES" : "TRIANGLES");
  }
  void add_view(std::size_t view, const std::vector<unsigned char>& coded, std::size_t count,
                std::size_t stride, const std::string& mode) {
    while (result_.binary.size() % 4 != 0) result_.binary.push_back('\0');
    const int data_buffer = form_.fallback_is_first ? 1 : 0;
    result_.json["bufferViews"][view] = {{"buffer", 1 - data_buffer},
                                         {"byteOffset", fallback_bytes_},
                                         {"byteLength", count * stride}};
    result_.json["bufferViews"][view]["extensions"][form_.extension] = {
        {"buffer", data_buffer},
        {"byteOffset", result_.binary.size()},
        {"byteLength", coded.size()},
        {"byteStride", stride},
        {"count", count},
        {"mode", mode}};
    fallback_bytes_ += (count * stride + 3) / 4 * 4;
    result_.binary.append(coded.begin(), coded.end());
  }

  const GltfBuilder& plain_;
  MeshoptForm form_;
  GltfBuilder result_;
  std::size_t fallback_bytes_ = 0;
};

inline GltfBuilder meshopt_gltf(const Sheet& sheet, const MeshoptForm& form = {}) {
  const GltfBuilder plain = plain_gltf(sheet);
  return MeshoptWriter(plain, form).write();
}

// --- Draco ---

struct DracoForm {
  bool sequential = false;  // Draco's other method of connectivity
  bool quantized = false;
};

inline GltfBuilder draco_gltf(const Sheet& sheet, const DracoForm& form = {}) {
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(static_cast<int>(sheet.indices.size() / 3));
  nlohmann::json identifiers;
  GltfBuilder file;
  nlohmann::json attributes;
  std::vector<int> quantization;
  const auto add = [&](const char* key, draco::GeometryAttribute::Type kind, draco::DataType type,
                       const auto& values, int width, int component, int bits) {
    const int id = builder.AddAttribute(kind, static_cast<std::int8_t>(width), type);
    const auto at = [&](std::size_t corner) {
      return &values[static_cast<std::size_t>(width) * sheet.indices[corner]];
    };
    for (std::uint32_t face = 0; face < sheet.indices.size() / 3; ++face) {
      builder.SetAttributeValuesForFace(id, draco::FaceIndex(face), at(3 * face), at(3 * face + 1),
                                        at(3 * face + 2));
    }
    identifiers[key] = id;
    attributes[key] = file.json["accessors"].size();
    file.json["accessors"].push_back(
        {{"componentType", component}, {"type", fmt::format("VEC{}", width)}});
    quantization.push_back(form.quantized ? bits : 0);
  };
  using Kind = draco::GeometryAttribute;
  add("POSITION", Kind::POSITION, draco::DT_FLOAT32, sheet.positions, 3, 5126, 14);
  add("NORMAL", Kind::NORMAL, draco::DT_FLOAT32, sheet.normals, 3, 5126, 10);
  add("TEXCOORD_0", Kind::TEX_COORD, draco::DT_FLOAT32, sheet.texcoords, 2, 5126, 12);
  add("COLOR_0", Kind::COLOR, draco::DT_UINT8, sheet.colors, 4, 5121, 0);
  add("JOINTS_0", Kind::GENERIC, draco::DT_UINT8, sheet.joints, 4, 5121, 0);
  add("WEIGHTS_0", Kind::GENERIC, draco::DT_FLOAT32, sheet.weights, 4, 5126, 12);
  const std::unique_ptr<draco::Mesh> mesh = builder.Finalize();
  draco::ExpertEncoder encoder(*mesh);
  encoder.SetEncodingMethod(form.sequential ? draco::MESH_SEQUENTIAL_ENCODING
                                            : draco::MESH_EDGEBREAKER_ENCODING);
  for (std::size_t i = 0; i < quantization.size(); ++i) {
    if (quantization[i] > 0) encoder.SetAttributeQuantization(static_cast<int>(i), quantization[i]);
  }
  draco::EncoderBuffer coded;
  if (!encoder.EncodeToBuffer(&coded).ok()) return file;
  const std::size_t view =
      file.view(std::vector<std::uint8_t>(coded.data(), coded.data() + coded.size()));
  for (nlohmann::json& accessor : file.json["accessors"]) accessor["count"] = mesh->num_points();
  file.json["accessors"][3]["normalized"] = true;
  file.json["accessors"].push_back(
      {{"componentType", 5123}, {"type", "SCALAR"}, {"count", sheet.indices.size()}});
  add_skinned_sheet(file, attributes, file.json["accessors"].size() - 1);
  file.primitive()["extensions"]["KHR_draco_mesh_compression"] = {{"bufferView", view},
                                                                  {"attributes", identifiers}};
  file.json["extensionsUsed"] = {"KHR_draco_mesh_compression"};
  file.json["extensionsRequired"] = {"KHR_draco_mesh_compression"};
  return file;
}

}  // namespace penumbra::test
