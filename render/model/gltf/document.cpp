#include "render/model/gltf/document.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra::gltf {
namespace {

using Json = nlohmann::json;

std::uint32_t word_at(std::span<const std::uint8_t> bytes, std::size_t offset) {
  std::uint32_t word = 0;  // glTF is little-endian, like all supported machines
  std::memcpy(&word, bytes.data() + offset, 4);
  return word;
}

// Returns the nesting depth of brackets outside strings. Limits the recursion of JSON readers.
int nesting_depth(std::string_view json) {
  int depth = 0, deepest = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < json.size(); ++i) {
    const char c = json[i];
    if (in_string) {
      if (c == '\\') ++i;
      in_string = c != '"';
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      deepest = std::max(deepest, ++depth);
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return deepest;
}

constexpr double kLargestIndex = 2147483647.0;       // maximum of tinygltf's int
constexpr double kLargestSize = 9007199254740992.0;  // doubles represent all integers up to here

// One key or index of the JSON path to a value.
struct PathStep {
  const PathStep* parent = nullptr;
  std::string_view key;
  std::size_t index = 0;  // element of a list, if the key is empty

  [[nodiscard]] std::string text() const {
    const std::string step = key.empty() ? std::to_string(index) : shortened(key, 80);
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

// The permitted values of a field.
struct FieldType {
  std::string_view expected;
  bool (*matches)(Json& value);
};
bool all_match(Json& values, const FieldType& type) {
  return std::all_of(values.begin(), values.end(), type.matches);
}
constexpr FieldType kIndex{"a whole number from 0 on",
                           [](Json& v) { return is_whole(v, kLargestIndex); }};
constexpr FieldType kSize{"a whole number from 0 on",
                          [](Json& v) { return is_whole(v, kLargestSize); }};
constexpr FieldType kNumber{"a number", [](Json& v) { return v.is_number(); }};
constexpr FieldType kFlag{"true or false", [](Json& v) { return v.is_boolean(); }};
constexpr FieldType kText{"a string", [](Json& v) { return v.is_string(); }};
constexpr FieldType kObject{"an object", [](Json& v) { return v.is_object(); }};
constexpr FieldType kIndices{"a list of whole numbers from 0 on",
                             [](Json& v) { return v.is_array() && all_match(v, kIndex); }};
constexpr FieldType kNumbers{"a list of numbers",
                             [](Json& v) { return v.is_array() && all_match(v, kNumber); }};
constexpr FieldType kTexts{"a list of strings",
                           [](Json& v) { return v.is_array() && all_match(v, kText); }};
constexpr FieldType kIndexMap{"an object of whole numbers from 0 on",
                              [](Json& v) { return v.is_object() && all_match(v, kIndex); }};

std::string quoted(const Json& value) {
  const std::string text = value.dump(-1, ' ', true, Json::error_handler_t::replace);
  return shortened(text, 43);
}

class FieldChecker {
 public:
  // `path`: keys, or '*' for all elements of a list, separated by '/'.
  std::optional<std::string> check(Json& at, std::string_view path, const FieldType& type,
                                   const PathStep* json_path = nullptr) {
    if (path.empty()) {
      if (type.matches(at)) return std::nullopt;
      return type_error(at, type.expected, json_path);
    }
    const std::size_t slash = path.find('/');
    const std::string_view head = path.substr(0, slash);
    const std::string_view rest = slash == std::string_view::npos ? "" : path.substr(slash + 1);
    if (head == "*") {
      if (!at.is_array()) return type_error(at, "a list", json_path);
      for (std::size_t i = 0; i < at.size(); ++i) {
        const PathStep next{json_path, {}, i};
        if (auto fault = check(at[i], rest, type, &next)) return fault;
      }
      return std::nullopt;
    }
    if (!at.is_object()) return type_error(at, "an object", json_path);
    const auto entry = at.find(head);
    if (entry == at.end()) return std::nullopt;
    if (entry->is_null()) {
      at.erase(entry);
      return std::nullopt;
    }
    const PathStep next{json_path, head, 0};
    std::optional<std::string> fault = check(*entry, rest, type, &next);
    // Lists are never erased: other fields refer to their elements by index.
    if (!fault || !erases || json_path == nullptr) return fault;
    erased.push_back(std::move(*fault));
    at.erase(entry);
    return std::nullopt;
  }

  bool erases = false;  // erases invalid fields instead of returning an error
  std::vector<std::string> erased;

 private:
  static std::string type_error(const Json& value, std::string_view expected,
                                const PathStep* json_path) {
    return fmt::format("{}: is {}; {} is expected", json_path == nullptr ? "" : json_path->text(),
                       quoted(value), expected);
  }
};

struct Field {
  std::string_view path;
  const FieldType& type;
};

constexpr std::array kFields{
    Field{"asset", kObject},
    Field{"extensionsUsed", kTexts},
    Field{"extensionsRequired", kTexts},
    Field{"scene", kIndex},
    Field{"scenes/*", kObject},
    Field{"scenes/*/nodes", kIndices},
    Field{"nodes/*/mesh", kIndex},
    Field{"nodes/*/skin", kIndex},
    Field{"nodes/*/children", kIndices},
    Field{"nodes/*/matrix", kNumbers},
    Field{"nodes/*/translation", kNumbers},
    Field{"nodes/*/rotation", kNumbers},
    Field{"nodes/*/scale", kNumbers},
    Field{"nodes/*/weights", kNumbers},
    Field{"nodes/*/extensions", kObject},
    Field{"nodes/*/extensions/EXT_mesh_gpu_instancing/attributes", kIndexMap},
    Field{"nodes/*/extensions/KHR_node_visibility/visible", kFlag},
    Field{"meshes/*/weights", kNumbers},
    Field{"meshes/*/primitives/*/attributes", kIndexMap},
    Field{"meshes/*/primitives/*/indices", kIndex},
    Field{"meshes/*/primitives/*/material", kIndex},
    Field{"meshes/*/primitives/*/mode", kIndex},
    Field{"meshes/*/primitives/*/targets/*", kIndexMap},
    Field{"meshes/*/primitives/*/extensions", kObject},
    Field{"meshes/*/primitives/*/extensions/KHR_draco_mesh_compression/attributes", kIndexMap},
    Field{"meshes/*/primitives/*/extensions/KHR_draco_mesh_compression/bufferView", kIndex},
    Field{"skins/*/joints", kIndices},
    Field{"skins/*/inverseBindMatrices", kIndex},
    Field{"accessors/*/bufferView", kIndex},
    Field{"accessors/*/byteOffset", kSize},
    Field{"accessors/*/componentType", kIndex},
    Field{"accessors/*/normalized", kFlag},
    Field{"accessors/*/count", kSize},
    Field{"accessors/*/type", kText},
    Field{"accessors/*/sparse/count", kIndex},
    Field{"accessors/*/sparse/indices/bufferView", kIndex},
    Field{"accessors/*/sparse/indices/byteOffset", kIndex},
    Field{"accessors/*/sparse/indices/componentType", kIndex},
    Field{"accessors/*/sparse/values/bufferView", kIndex},
    Field{"accessors/*/sparse/values/byteOffset", kIndex},
    Field{"bufferViews/*/buffer", kIndex},
    Field{"bufferViews/*/byteOffset", kSize},
    Field{"bufferViews/*/byteLength", kSize},
    Field{"bufferViews/*/byteStride", kSize},
    Field{"bufferViews/*/extensions", kObject},
    Field{"bufferViews/*/extensions/EXT_meshopt_compression/buffer", kIndex},
    Field{"bufferViews/*/extensions/EXT_meshopt_compression/byteOffset", kIndex},
    Field{"bufferViews/*/extensions/EXT_meshopt_compression/byteLength", kIndex},
    Field{"bufferViews/*/extensions/EXT_meshopt_compression/byteStride", kIndex},
    Field{"bufferViews/*/extensions/EXT_meshopt_compression/count", kIndex},
    Field{"bufferViews/*/extensions/EXT_meshopt_compression/mode", kText},
    Field{"bufferViews/*/extensions/EXT_meshopt_compression/filter", kText},
    Field{"bufferViews/*/extensions/KHR_meshopt_compression/buffer", kIndex},
    Field{"bufferViews/*/extensions/KHR_meshopt_compression/byteOffset", kIndex},
    Field{"bufferViews/*/extensions/KHR_meshopt_compression/byteLength", kIndex},
    Field{"bufferViews/*/extensions/KHR_meshopt_compression/byteStride", kIndex},
    Field{"bufferViews/*/extensions/KHR_meshopt_compression/count", kIndex},
    Field{"bufferViews/*/extensions/KHR_meshopt_compression/mode", kText},
    Field{"bufferViews/*/extensions/KHR_meshopt_compression/filter", kText},
    Field{"buffers/*/byteLength", kSize},
    Field{"buffers/*/uri", kText},
};

// Fields that do not affect the geometry.
constexpr std::array kAppearance{
    Field{"images/*/bufferView", kIndex},
    Field{"images/*/uri", kText},
    Field{"textures/*/source", kIndex},
    Field{"textures/*/sampler", kIndex},
    Field{"textures/*/extensions", kObject},
    Field{"textures/*/extensions/EXT_texture_webp/source", kIndex},
    Field{"samplers/*/magFilter", kIndex},
    Field{"samplers/*/minFilter", kIndex},
    Field{"samplers/*/wrapS", kIndex},
    Field{"samplers/*/wrapT", kIndex},
    Field{"materials/*/extensions", kObject},
    Field{"materials/*/extensions/KHR_materials_unlit", kObject},
    Field{"materials/*/extensions/KHR_materials_emissive_strength/emissiveStrength", kNumber},
    Field{"materials/*/alphaMode", kText},
    Field{"materials/*/alphaCutoff", kNumber},
    Field{"materials/*/doubleSided", kFlag},
    Field{"materials/*/emissiveFactor", kNumbers},
    Field{"materials/*/pbrMetallicRoughness/baseColorFactor", kNumbers},
    Field{"materials/*/pbrMetallicRoughness/metallicFactor", kNumber},
    Field{"materials/*/pbrMetallicRoughness/roughnessFactor", kNumber},
    Field{"materials/*/normalTexture/scale", kNumber},
    Field{"materials/*/occlusionTexture/strength", kNumber},
};

constexpr std::array<std::string_view, 5> kTextureInfos = {
    "materials/*/pbrMetallicRoughness/baseColorTexture",
    "materials/*/pbrMetallicRoughness/metallicRoughnessTexture",
    "materials/*/normalTexture",
    "materials/*/occlusionTexture",
    "materials/*/emissiveTexture",
};
// Fields of each texture reference.
constexpr std::array kTextureInfoFields{
    Field{"index", kIndex},
    Field{"texCoord", kIndex},
    Field{"extensions", kObject},
    Field{"extensions/KHR_texture_transform", kObject},
    Field{"extensions/KHR_texture_transform/offset", kNumbers},
    Field{"extensions/KHR_texture_transform/rotation", kNumber},
    Field{"extensions/KHR_texture_transform/scale", kNumbers},
    Field{"extensions/KHR_texture_transform/texCoord", kIndex},
};

// Checks the types of all fields that are read, because tinygltf treats a field of a wrong type as
// absent. Returns the JSON path and error of the first invalid field. Converts integers written as
// 1.0; erases null fields. Invalid fields of kAppearance are erased and listed in `erased`.
std::optional<std::string> find_invalid_field(Json& root, std::vector<std::string>& erased) {
  FieldChecker checker;
  for (const Field& field : kFields) {
    if (auto fault = checker.check(root, field.path, field.type)) return fault;
  }
  checker.erases = true;
  for (const Field& field : kAppearance) {
    if (auto fault = checker.check(root, field.path, field.type)) return fault;
  }
  for (const std::string_view info : kTextureInfos) {
    for (const Field& field : kTextureInfoFields) {
      const std::string path = fmt::format("{}/{}", info, field.path);
      if (auto fault = checker.check(root, path, field.type)) return fault;
    }
  }
  erased = std::move(checker.erased);
  return std::nullopt;
}

// Fields of each animation. Errors concern only those who play it.
constexpr std::array kAnimationFields{
    Field{"", kObject},
    Field{"name", kText},
    Field{"channels/*/sampler", kIndex},
    Field{"channels/*/target/node", kIndex},
    Field{"channels/*/target/path", kText},
    Field{"samplers/*/input", kIndex},
    Field{"samplers/*/output", kIndex},
    Field{"samplers/*/interpolation", kText},
};

AnimationSource animation_from(Json& from, std::size_t index) {
  AnimationSource animation;
  const PathStep list{nullptr, "animations"};
  const PathStep json_path{&list, {}, index};
  FieldChecker checker;
  for (const Field& field : kAnimationFields) {
    const auto fault = checker.check(from, field.path, field.type, &json_path);
    if (!fault) continue;
    animation.fault = *fault;
    return animation;
  }
  animation.name = from.value("name", "");
  for (const Json& sampler : from.value("samplers", Json::array())) {
    animation.samplers.push_back({sampler.value("input", -1), sampler.value("output", -1),
                                  sampler.value("interpolation", "LINEAR")});
  }
  for (const Json& channel : from.value("channels", Json::array())) {
    const Json target = channel.value("target", Json::object());
    animation.channels.push_back(
        {channel.value("sampler", -1), target.value("node", -1), target.value("path", "")});
  }
  return animation;
}

// Returns the first line of a library's message, without the name of its exception.
std::string first_line(std::string text) {
  if (text.starts_with("[")) text.erase(0, std::min(text.find("] "), text.size() - 2) + 2);
  const std::string line = text.substr(0, text.find('\n'));
  return line.empty() ? "malformed" : line.substr(0, 200);
}

void find_extensions(const Json& at, const std::string& json_path,
                     std::map<std::string, std::string>& first_json_paths) {
  if (at.is_array()) {
    for (std::size_t i = 0; i < at.size(); ++i) {
      if (at[i].is_structured())
        find_extensions(at[i], fmt::format("{}/{}", json_path, i), first_json_paths);
    }
  }
  if (!at.is_object()) return;
  for (const auto& [key, value] : at.items()) {
    if (key == "extras" || !value.is_structured()) continue;
    if (key == "extensions" && value.is_object()) {
      for (const auto& [extension, content] : value.items()) {
        first_json_paths.try_emplace(extension, json_path.empty() ? "the file" : json_path);
      }
    }
    find_extensions(value, json_path.empty() ? key : json_path + "/" + key, first_json_paths);
  }
}

// Moves a list out of the JSON, because tinygltf would decode it differently or reject the file.
Json extract_list(Json& root, const char* key) {
  const auto entry = root.find(key);
  if (entry == root.end()) return Json::array();
  Json list = std::move(*entry);
  root.erase(entry);
  return list.is_array() ? list : Json::array();
}

// Moves indices to attributes: tinygltf omits primitives without attributes and rejects indices
// without a buffer view.
void prepare_primitives(Json& root) {
  if (!root.contains("meshes")) return;
  for (Json& mesh : root.at("meshes")) {
    if (!mesh.contains("primitives")) continue;
    for (Json& primitive : mesh.at("primitives")) {
      Json& attributes = primitive["attributes"];
      if (attributes.is_null()) attributes = Json::object();
      const auto indices = primitive.find("indices");
      if (indices == primitive.end()) continue;
      attributes[kIndicesKey] = *indices;
      primitive.erase(indices);
    }
  }
}

// Returns the file's glTF version if it is not 2. Files of version 1.0 may omit the version; their
// meshes are an object, not an array.
std::optional<std::string> unsupported_version(const Json& root) {
  const auto asset = root.find("asset");
  if (asset != root.end() && asset->is_object() && asset->contains("version")) {
    const Json& version = asset->at("version");
    if (!version.is_string() && !version.is_number()) return std::nullopt;  // tinygltf skips it
    // Some exporters of version 1.0 wrote a number.
    const std::string text = version.is_string() ? version.get<std::string>() : version.dump();
    if (text == "2" || text.starts_with("2.")) return std::nullopt;
    return text.substr(0, 20);
  }
  const auto meshes = root.find("meshes");
  if (meshes != root.end() && meshes->is_object()) return "1.0";
  return std::nullopt;
}

}  // namespace

Result<Container> open_glb(const std::string& name, std::span<const std::uint8_t> bytes) {
  constexpr std::uint32_t kMagic = 0x46546C67, kJson = 0x4E4F534A, kBinary = 0x004E4942;
  if (bytes.size() >= 4 && bytes.size() < 20 && word_at(bytes, 0) == kMagic) {
    return fail("{}: is cut short; export it again", name);
  }
  if (bytes.size() < 20 || word_at(bytes, 0) != kMagic) {
    return fail("{}: is not a binary glTF file (it does not start with \"glTF\"); export it again",
                name);
  }
  if (word_at(bytes, 4) != 2) {
    return fail("{}: is glTF version {}; export it as version 2", name, word_at(bytes, 4));
  }
  const std::size_t length = word_at(bytes, 8);
  if (length > bytes.size()) {
    return fail("{}: is cut off: {} of {} bytes; copy or export it again", name, bytes.size(),
                length);
  }
  Container container;
  std::size_t offset = 12;
  for (int chunk = 0; offset < length; ++chunk) {
    if (length - offset < 8 || word_at(bytes, offset) > length - offset - 8) {
      return fail("{}: chunk {} reaches past the end of the file; export it again", name, chunk);
    }
    const std::size_t size = word_at(bytes, offset);
    if (chunk == 0) {
      if (word_at(bytes, offset + 4) != kJson) {
        return fail("{}: its first chunk is not JSON; export it again", name);
      }
      container.json = {reinterpret_cast<const char*>(bytes.data()) + offset + 8, size};
    } else if (chunk == 1 && word_at(bytes, offset + 4) == kBinary) {
      container.binary = bytes.subspan(offset + 8, size);
    }
    offset += 8 + size;
  }
  return container;
}

Result<Document> parse_document(const std::string& name, std::string_view text) {
  PENUMBRA_TRY(const std::string_view json, without_byte_order_mark(text, name));
  if (nesting_depth(json) > kMaxModelDepth) {
    return fail("{}: its JSON is nested deeper than {} levels", name, kMaxModelDepth);
  }
  Json root;
  try {
    root = Json::parse(json.begin(), json.end());
  } catch (const Json::exception& error) {
    return fail("{}: is not glTF 2.0: {}", name, first_line(error.what()));
  }
  if (!root.is_object()) return fail("{}: is not glTF 2.0: its JSON is not an object", name);
  if (const std::optional<std::string> version = unsupported_version(root)) {
    return fail("{}: asset: version is '{}'; only glTF 2.0 is read, export it as that", name,
                *version);
  }
  Document document;
  if (const std::optional<std::string> fault = find_invalid_field(root, document.erased_fields)) {
    return fail("{}: {}", name, *fault);
  }
  find_extensions(root, "", document.extensions);
  for (const Json& buffer : extract_list(root, "buffers")) {
    if (!buffer.is_object() || !buffer.contains("byteLength")) {
      return fail("{}: buffers/{}: has no byteLength", name, document.buffers.size());
    }
    document.buffers.push_back(
        {buffer.value("uri", ""), buffer.at("byteLength").get<std::size_t>()});
  }
  for (const Json& image : extract_list(root, "images")) {
    const bool known = image.is_object();
    document.images.push_back(
        {known ? image.value("uri", "") : "", known ? image.value("bufferView", -1) : -1});
  }
  Json animations = extract_list(root, "animations");
  for (std::size_t i = 0; i < animations.size(); ++i)
    document.animations.push_back(animation_from(animations[i], i));
  document.camera_count = extract_list(root, "cameras").size();
  root.erase("extensions");
  prepare_primitives(root);
  const std::string prepared = root.dump(-1, ' ', false, Json::error_handler_t::replace);
  if (prepared.size() > std::numeric_limits<unsigned>::max()) {
    return fail("{}: its JSON is over 4 GB", name);
  }
  tinygltf::TinyGLTF reader;
  std::string error, warning;
  if (!reader.LoadASCIIFromString(&document.model, &error, &warning, prepared.data(),
                                  static_cast<unsigned>(prepared.size()), "")) {
    return fail("{}: is not glTF 2.0: {}", name, first_line(error));
  }
  if (document.model.asset.version.empty()) {
    return fail("{}: asset: version is missing; export it as glTF 2.0", name);
  }
  return document;
}

}  // namespace penumbra::gltf
