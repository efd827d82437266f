#include "render/model/gltf/fields.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>

namespace penumbra::gltf {
namespace {

using Json = nlohmann::json;

enum class Kind { index, size, number, flag, text, indices, numbers, texts, index_map, object };

constexpr double kLargestIndex = 2147483647.0;       // tinygltf's int
constexpr double kLargestSize = 9007199254740992.0;  // whole in a double

// One step of the way to a value.
struct Place {
  const Place* parent = nullptr;
  std::string_view key;
  std::size_t index = 0;  // of a list, where the key is empty

  [[nodiscard]] std::string text() const {
    const std::string step = key.empty() ? std::to_string(index) : std::string(key.substr(0, 80));
    return parent == nullptr ? step : parent->text() + "/" + step;
  }
};

bool is_whole(Json& value, double largest) {
  if (!value.is_number()) return false;
  const auto number = value.get<double>();
  if (!(number >= 0.0 && number <= largest) || number != std::floor(number)) return false;
  if (value.is_number_float()) value = static_cast<std::uint64_t>(number);
  return true;
}

template <class Check>
bool every(Json& list, const Check& check) {
  if (!list.is_structured()) return false;
  for (Json& value : list) {
    if (!check(value)) return false;
  }
  return true;
}

// Returns what a value should be, or nothing where it is that.
std::optional<std::string_view> wrong_kind(Json& value, Kind kind) {
  const auto is_index = [](Json& v) { return is_whole(v, kLargestIndex); };
  const auto is_number = [](const Json& v) { return v.is_number(); };
  const auto is_text = [](const Json& v) { return v.is_string(); };
  const auto unless = [](bool good, std::string_view expected) {
    return good ? std::nullopt : std::optional(expected);
  };
  switch (kind) {
    case Kind::index:
      return unless(is_index(value), "a whole number from 0 on");
    case Kind::size:
      return unless(is_whole(value, kLargestSize), "a whole number from 0 on");
    case Kind::number:
      return unless(value.is_number(), "a number");
    case Kind::flag:
      return unless(value.is_boolean(), "true or false");
    case Kind::text:
      return unless(value.is_string(), "a string");
    case Kind::indices:
      return unless(value.is_array() && every(value, is_index),
                    "a list of whole numbers from 0 on");
    case Kind::numbers:
      return unless(value.is_array() && every(value, is_number), "a list of numbers");
    case Kind::texts:
      return unless(value.is_array() && every(value, is_text), "a list of strings");
    case Kind::index_map:
      return unless(value.is_object() && every(value, is_index),
                    "an object of whole numbers from 0 on");
    case Kind::object:
      break;
  }
  return unless(value.is_object(), "an object");
}

std::string quoted(const Json& value) {
  const std::string text = value.dump(-1, ' ', true, Json::error_handler_t::replace);
  return text.size() > 40 ? text.substr(0, 40) + "..." : text;
}

class FieldChecker {
 public:
  // `path`: keys and '*' for the elements of a list, with '/' between them.
  std::optional<std::string> check(Json& at, std::string_view path, Kind kind,
                                   const Place* place = nullptr) {
    if (path.empty()) {
      const auto expected = wrong_kind(at, kind);
      return expected ? std::optional(wrong(at, *expected, place)) : std::nullopt;
    }
    const std::size_t slash = path.find('/');
    const std::string_view head = path.substr(0, slash);
    const std::string_view rest = slash == std::string_view::npos ? "" : path.substr(slash + 1);
    if (head == "*") {
      if (!at.is_array()) return wrong(at, "a list", place);
      for (std::size_t i = 0; i < at.size(); ++i) {
        const Place next{place, {}, i};
        if (auto fault = check(at[i], rest, kind, &next)) return fault;
      }
      return std::nullopt;
    }
    if (!at.is_object()) return wrong(at, "an object", place);
    const auto entry = at.find(head);
    if (entry == at.end()) return std::nullopt;
    if (entry->is_null()) {
      at.erase(entry);
      return std::nullopt;
    }
    const Place next{place, head, 0};
    std::optional<std::string> fault = check(*entry, rest, kind, &next);
    // A list is never erased: others name its elements by their number.
    if (!fault || !erases || place == nullptr) return fault;
    erased.push_back(std::move(*fault));
    at.erase(entry);
    return std::nullopt;
  }

  bool erases = false;  // wrong fields
  std::vector<std::string> erased;

 private:
  static std::string wrong(const Json& value, std::string_view expected, const Place* place) {
    return fmt::format("{}: is {}; {} is expected", place == nullptr ? "" : place->text(),
                       quoted(value), expected);
  }
};

struct Field {
  std::string_view path;
  Kind kind;
};

constexpr std::array kFields{
    Field{"asset", Kind::object},
    Field{"extensionsUsed", Kind::texts},
    Field{"extensionsRequired", Kind::texts},
    Field{"scene", Kind::index},
    Field{"scenes/*", Kind::object},
    Field{"scenes/*/nodes", Kind::indices},
    Field{"nodes/*/mesh", Kind::index},
    Field{"nodes/*/skin", Kind::index},
    Field{"nodes/*/children", Kind::indices},
    Field{"nodes/*/matrix", Kind::numbers},
    Field{"nodes/*/translation", Kind::numbers},
    Field{"nodes/*/rotation", Kind::numbers},
    Field{"nodes/*/scale", Kind::numbers},
    Field{"nodes/*/weights", Kind::numbers},
    Field{"nodes/*/extensions", Kind::object},
    Field{"nodes/*/extensions/EXT_mesh_gpu_instancing/attributes", Kind::index_map},
    Field{"nodes/*/extensions/KHR_node_visibility/visible", Kind::flag},
    Field{"meshes/*/weights", Kind::numbers},
    Field{"meshes/*/primitives/*/attributes", Kind::index_map},
    Field{"meshes/*/primitives/*/indices", Kind::index},
    Field{"meshes/*/primitives/*/material", Kind::index},
    Field{"meshes/*/primitives/*/mode", Kind::index},
    Field{"meshes/*/primitives/*/targets/*", Kind::index_map},
    Field{"meshes/*/primitives/*/extensions", Kind::object},
    Field{"meshes/*/primitives/*/extensions/KHR_draco_mesh_compression/attributes",
          Kind::index_map},
    Field{"skins/*/joints", Kind::indices},
    Field{"skins/*/inverseBindMatrices", Kind::index},
    Field{"accessors/*/bufferView", Kind::index},
    Field{"accessors/*/byteOffset", Kind::size},
    Field{"accessors/*/componentType", Kind::index},
    Field{"accessors/*/normalized", Kind::flag},
    Field{"accessors/*/count", Kind::size},
    Field{"accessors/*/type", Kind::text},
    Field{"accessors/*/sparse/count", Kind::index},
    Field{"accessors/*/sparse/indices/bufferView", Kind::index},
    Field{"accessors/*/sparse/indices/byteOffset", Kind::index},
    Field{"accessors/*/sparse/indices/componentType", Kind::index},
    Field{"accessors/*/sparse/values/bufferView", Kind::index},
    Field{"accessors/*/sparse/values/byteOffset", Kind::index},
    Field{"bufferViews/*/buffer", Kind::index},
    Field{"bufferViews/*/byteOffset", Kind::size},
    Field{"bufferViews/*/byteLength", Kind::size},
    Field{"bufferViews/*/byteStride", Kind::size},
    Field{"bufferViews/*/extensions", Kind::object},
    Field{"buffers/*/byteLength", Kind::size},
    Field{"buffers/*/uri", Kind::text},
};

// Fields that do not change the shape.
constexpr std::array kAppearance{
    Field{"images/*/bufferView", Kind::index},
    Field{"images/*/uri", Kind::text},
    Field{"textures/*/source", Kind::index},
    Field{"textures/*/sampler", Kind::index},
    Field{"textures/*/extensions", Kind::object},
    Field{"samplers/*/magFilter", Kind::index},
    Field{"samplers/*/minFilter", Kind::index},
    Field{"samplers/*/wrapS", Kind::index},
    Field{"samplers/*/wrapT", Kind::index},
    Field{"materials/*/extensions", Kind::object},
    Field{"materials/*/alphaMode", Kind::text},
    Field{"materials/*/alphaCutoff", Kind::number},
    Field{"materials/*/doubleSided", Kind::flag},
    Field{"materials/*/emissiveFactor", Kind::numbers},
    Field{"materials/*/pbrMetallicRoughness/baseColorFactor", Kind::numbers},
    Field{"materials/*/pbrMetallicRoughness/metallicFactor", Kind::number},
    Field{"materials/*/pbrMetallicRoughness/roughnessFactor", Kind::number},
    Field{"materials/*/normalTexture/scale", Kind::number},
    Field{"materials/*/occlusionTexture/strength", Kind::number},
};

constexpr std::array<std::string_view, 5> kTextures{
    "materials/*/pbrMetallicRoughness/baseColorTexture",
    "materials/*/pbrMetallicRoughness/metallicRoughnessTexture", "materials/*/normalTexture",
    "materials/*/occlusionTexture", "materials/*/emissiveTexture"};

}  // namespace

std::optional<std::string> wrong_field(Json& root, std::vector<std::string>& erased) {
  FieldChecker checker;
  for (const Field& field : kFields) {
    if (auto fault = checker.check(root, field.path, field.kind)) return fault;
  }
  checker.erases = true;
  for (const Field& field : kAppearance) {
    if (auto fault = checker.check(root, field.path, field.kind)) return fault;
  }
  for (const std::string_view texture : kTextures) {
    for (const char* index : {"/index", "/texCoord"}) {
      const std::string path = std::string(texture) + index;
      if (auto fault = checker.check(root, path, Kind::index)) return fault;
    }
  }
  erased = std::move(checker.erased);
  return std::nullopt;
}

}  // namespace penumbra::gltf
