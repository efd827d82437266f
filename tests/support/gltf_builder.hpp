// Builds small glTF files in memory: accessors are appended to one buffer, and tests may edit the
// JSON.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace penumbra::test {

inline std::string base64(std::string_view bytes) {
  constexpr std::string_view kAlphabet =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      bits = bits << 8U | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0U);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      text += i + k <= bytes.size() ? kAlphabet[bits >> (18 - 6 * k) & 63U] : '=';
    }
  }
  return text;
}

class GltfBuilder {
 public:
  nlohmann::json json = {{"asset", {{"version", "2.0"}}}, {"scene", 0}};
  std::string binary;

  // Appends values as a buffer view; returns its index.
  template <class T>
  std::size_t view(const std::vector<T>& values) {
    binary.resize((binary.size() + 3) / 4 * 4, '\0');
    json["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", binary.size()}, {"byteLength", values.size() * sizeof(T)}});
    const std::size_t offset = binary.size();
    binary.resize(offset + values.size() * sizeof(T));
    std::memcpy(binary.data() + offset, values.data(), values.size() * sizeof(T));
    return json["bufferViews"].size() - 1;
  }
  // Appends values as an accessor; `type`: "SCALAR", "VEC3" and so on. Returns its index.
  template <class T>
  std::size_t accessor(const std::vector<T>& values, const std::string& type,
                       bool normalized = false) {
    const std::size_t width = type == "SCALAR" ? 1
                              : type == "MAT4" ? 16
                                               : static_cast<std::size_t>(type.back() - '0');
    json["accessors"].push_back({{"bufferView", view(values)},
                                 {"componentType", component_type<T>()},
                                 {"count", values.size() / width},
                                 {"type", type}});
    if (normalized) json["accessors"].back()["normalized"] = true;
    return json["accessors"].size() - 1;
  }
  // Appends an accessor without a buffer view: zeros, except for `vectors` at `indices`. Returns
  // its index.
  std::size_t sparse_accessor(std::size_t count, const std::vector<std::uint16_t>& indices,
                              const std::vector<float>& vectors) {
    const std::size_t index_view = view(indices), value_view = view(vectors);
    json["accessors"].push_back(
        {{"componentType", 5126},
         {"count", count},
         {"type", "VEC3"},
         {"sparse",
          {{"count", indices.size()},
           {"indices", {{"bufferView", index_view}, {"componentType", 5123}}},
           {"values", {{"bufferView", value_view}}}}}});
    return json["accessors"].size() - 1;
  }
  // Appends a mesh of one primitive with these positions (x y z ...) and corners; returns its
  // index.
  std::size_t mesh(const std::vector<float>& positions, const std::vector<std::uint16_t>& corners) {
    const std::size_t position = accessor(positions, "VEC3");
    const std::size_t indices = accessor(corners, "SCALAR");
    json["meshes"].push_back(
        {{"primitives", {{{"attributes", {{"POSITION", position}}}, {"indices", indices}}}}});
    return json["meshes"].size() - 1;
  }
  // Appends a mesh: a square of `side` that faces the file's +y, with a corner at the origin.
  std::size_t square(float side) {
    return mesh({0, 0, 0, 0, 0, side, side, 0, side, side, 0, 0}, {0, 1, 2, 0, 2, 3});
  }
  // Adds a node to the scene; returns its index.
  std::size_t node(const nlohmann::json& fields) {
    json["nodes"].push_back(fields);
    json["scenes"][0]["nodes"].push_back(json["nodes"].size() - 1);
    return json["nodes"].size() - 1;
  }
  nlohmann::json& primitive(std::size_t mesh = 0) { return json["meshes"][mesh]["primitives"][0]; }

  // Returns a .gltf with its buffer embedded, unless `buffers` exists already.
  [[nodiscard]] std::string gltf() const {
    nlohmann::json file = json;
    if (!file.contains("buffers") && !binary.empty()) {
      file["buffers"].push_back(
          {{"byteLength", binary.size()},
           {"uri", "data:application/octet-stream;base64," + base64(binary)}});
    }
    return file.dump();
  }
  [[nodiscard]] std::string glb() const {
    nlohmann::json file = json;
    file["buffers"][0] = {{"byteLength", binary.size()}};
    std::string text = file.dump(), data = binary;
    text.resize((text.size() + 3) / 4 * 4, ' ');
    data.resize((data.size() + 3) / 4 * 4, '\0');
    std::string glb;
    const auto word = [&glb](std::size_t value) {
      for (unsigned shift = 0; shift < 32; shift += 8) {
        glb.push_back(static_cast<char>(value >> shift & 0xFFU));
      }
    };
    word(0x46546C67);
    word(2);
    word(12 + 8 + text.size() + 8 + data.size());
    word(text.size());
    word(0x4E4F534A);
    glb += text;
    word(data.size());
    word(0x004E4942);
    return glb + data;
  }

 private:
  template <class T>
  static constexpr int component_type() {
    if constexpr (std::is_same_v<T, std::int8_t>) return 5120;
    if constexpr (std::is_same_v<T, std::uint8_t>) return 5121;
    if constexpr (std::is_same_v<T, std::int16_t>) return 5122;
    if constexpr (std::is_same_v<T, std::uint16_t>) return 5123;
    if constexpr (std::is_same_v<T, std::uint32_t>) return 5125;
    return 5126;
  }
};

}  // namespace penumbra::test
