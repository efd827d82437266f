#include "render/model/gltf/document.hpp"

#include <nlohmann/json.hpp>
#include <optional>

#include "core/propagate.hpp"
#include "core/text/text_encoding.hpp"
#include "render/model/gltf/container.hpp"
#include "render/model/gltf/fields.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra::gltf {
namespace {

using Json = nlohmann::json;

// One line of a library's report, without the name of its exception.
std::string first_line(std::string text) {
  if (text.starts_with("[")) text.erase(0, std::min(text.find("] "), text.size() - 2) + 2);
  const std::string line = text.substr(0, text.find('\n'));
  return line.empty() ? "malformed" : line.substr(0, 200);
}

void count_extensions(const Json& at, const std::string& place,
                      std::map<std::string, ExtensionUse>& uses) {
  if (at.is_array()) {
    for (std::size_t i = 0; i < at.size(); ++i) {
      if (at[i].is_structured()) count_extensions(at[i], fmt::format("{}/{}", place, i), uses);
    }
  }
  if (!at.is_object()) return;
  for (const auto& [key, value] : at.items()) {
    if (key == "extras" || !value.is_structured()) continue;
    if (key == "extensions" && value.is_object()) {
      for (const auto& [extension, content] : value.items()) {
        ExtensionUse& use = uses[extension];
        if (use.count++ == 0) use.first_place = place.empty() ? "the file" : place;
      }
    }
    count_extensions(value, place.empty() ? key : place + "/" + key, uses);
  }
}

// Moves a list of the file's JSON out of it: tinygltf decodes what is in it in its own ways or
// refuses the file for it.
Json take_list(Json& root, const char* key) {
  const auto entry = root.find(key);
  if (entry == root.end()) return Json::array();
  Json list = std::move(*entry);
  root.erase(entry);
  return list.is_array() ? list : Json::array();
}

// tinygltf leaves out a primitive without attributes and refuses indices without a buffer view.
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

// The file's version where it is another than 2; nothing for 2. Files of glTF 1.0 may leave it out:
// they have objects where 2.0 has arrays.
std::optional<std::string> other_version(const Json& root) {
  const auto asset = root.find("asset");
  if (asset != root.end() && asset->is_object() && asset->contains("version")) {
    const Json& version = asset->at("version");
    if (!version.is_string() && !version.is_number()) return std::nullopt;  // for wrong_field()
    // Some exporters of version 1.0 wrote a number.
    const std::string text = version.is_string() ? version.get<std::string>() : version.dump();
    if (text == "2" || text.starts_with("2.")) return std::nullopt;
    return text.substr(0, 20);
  }
  const auto meshes = root.find("meshes");
  return meshes != root.end() && meshes->is_object() ? std::optional<std::string>("1.0")
                                                     : std::nullopt;
}

}  // namespace

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
  if (!root.is_object()) return fail("{}: is not glTF 2.0: its JSON is no object", name);
  if (const std::optional<std::string> version = other_version(root)) {
    return fail("{}: asset: version is '{}'; only glTF 2.0 is read, export it as that", name,
                *version);
  }
  Document document;
  if (const std::optional<std::string> fault = wrong_field(root, document.erased_fields)) {
    return fail("{}: {}", name, *fault);
  }
  count_extensions(root, "", document.extensions);
  for (const Json& buffer : take_list(root, "buffers")) {
    if (!buffer.is_object() || !buffer.contains("byteLength")) {
      return fail("{}: buffers/{}: has no byteLength", name, document.buffers.size());
    }
    document.buffers.push_back(
        {buffer.value("uri", ""), buffer.at("byteLength").get<std::size_t>()});
  }
  for (const Json& image : take_list(root, "images")) {
    const bool known = image.is_object();
    document.images.push_back(
        {known ? image.value("uri", "") : "", known ? image.value("bufferView", -1) : -1});
  }
  document.animation_count = take_list(root, "animations").size();
  document.camera_count = take_list(root, "cameras").size();
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
