#include "render/shadow/kernels/glb_document.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/gltf/buffers.hpp"
#include "render/model/gltf/compression/webp.hpp"
#include "render/model/gltf/document.hpp"
#include "render/model/gltf/extensions.hpp"
#include "render/model/model.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra {
namespace {

constexpr std::uint32_t kMagic = 0x46546C67;
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;
constexpr std::uint32_t kBinaryChunk = 0x004E4942;

using Json = GlbDocument::Json;

// A buffer of the file as a range of a buffer of the .glb.
struct MovedBuffer {
  std::size_t buffer = 0;
  std::size_t begin = 0;
};

// Redirects a buffer view, or an extension of it, to the buffers of the .glb.
void move_view(Json& view, const std::vector<MovedBuffer>& moved) {
  if (view.is_object() && view.contains("buffer")) {
    const MovedBuffer& to = moved.at(view.at("buffer").get<std::size_t>());
    const std::size_t offset = to.begin + view.value("byteOffset", std::size_t{0});
    view["buffer"] = to.buffer;
    if (offset != 0 || view.contains("byteOffset")) view["byteOffset"] = offset;
  }
  if (!view.contains("extensions")) return;
  for (auto& extension : view.at("extensions")) move_view(extension, moved);
}

// Returns the name of the extension that compresses a buffer view, or nullptr.
const char* compression_of(const Json& view) {
  for (const char* name : gltf::kMeshoptNames) {
    if (view.contains("extensions") && view.at("extensions").contains(name)) return name;
  }
  return nullptr;
}

// Marks the buffers with data that a buffer view, or an extension of it, refers to. The data of a
// compressed view is in the buffer of its extension.
void mark_buffers(const Json& view, std::vector<bool>& is_named) {
  if (view.is_object() && view.contains("buffer") && compression_of(view) == nullptr) {
    is_named.at(view.at("buffer").get<std::size_t>()) = true;
  }
  if (!view.contains("extensions")) return;
  for (const auto& extension : view.at("extensions")) mark_buffers(extension, is_named);
}

void require_extension(Json& json, const std::string& name) {
  for (const char* list : {"extensionsUsed", "extensionsRequired"}) {
    Json& names = json[list];
    if (!names.is_array()) names = Json::array();
    if (std::ranges::count(names, Json(name)) == 0) names.push_back(name);
  }
}

// Concatenates the buffers that buffer views refer to. Other buffers may be missing. Those of
// compressed views become one buffer without data.
Result<std::vector<std::uint8_t>> joined_buffers(Json& json, gltf::Buffers& buffers) {
  std::vector<std::uint8_t> binary;
  std::vector<MovedBuffer> moved(buffers.count());
  std::size_t placeholder_bytes = 0;
  std::vector<bool> is_named(buffers.count(), false);
  if (json.contains("bufferViews")) {
    for (const Json& view : json.at("bufferViews")) mark_buffers(view, is_named);
  }
  for (std::size_t i = 0; i < buffers.count(); ++i) {
    if (!is_named[i]) {
      moved[i] = {1, placeholder_bytes};
      const std::size_t size = json.at("buffers").at(i).at("byteLength").get<std::size_t>();
      placeholder_bytes += (size + 3) / 4 * 4;
      continue;
    }
    PENUMBRA_TRY(const auto bytes, buffers.bytes(i));
    while (binary.size() % 4 != 0) binary.push_back(0);
    moved[i] = {0, binary.size()};
    binary.insert(binary.end(), bytes.begin(), bytes.end());
  }
  if (moved.empty()) return binary;
  const char* compression = nullptr;
  if (json.contains("bufferViews")) {
    for (Json& view : json.at("bufferViews")) {
      if (compression == nullptr) compression = compression_of(view);
      move_view(view, moved);
    }
  }
  Json first = json.at("buffers").at(0);
  first.erase("uri");
  first.erase("extensions");
  json["buffers"] = Json::array({first});
  if (compression == nullptr) return binary;
  json["buffers"].push_back(
      {{"byteLength", placeholder_bytes}, {"extensions", {{compression, {{"fallback", true}}}}}});
  require_extension(json, compression);
  return binary;
}

void embed_images(GlbDocument& document, gltf::Buffers& buffers, const std::string& name,
                  std::vector<std::string>& warnings) {
  if (!document.json.contains("images")) return;
  for (std::size_t i = 0; i < document.json.at("images").size(); ++i) {
    const std::string uri = document.json.at("images").at(i).value("uri", "");
    if (uri.empty() || gltf::is_data_uri(uri)) continue;
    const auto bytes = buffers.fetch(uri);
    std::string type = bytes ? media_type_of(*bytes) : "";
    if (type.empty()) type = document.json.at("images").at(i).value("mimeType", "");
    if (!bytes || type.empty()) {
      warnings.push_back(without_control_characters(fmt::format(
          "{}: images/{}: is not in the .glb, which names it: {}", name, i,
          bytes ? "its kind is unknown; " + uri.substr(0, 80) : bytes.error().message)));
      continue;
    }
    const std::size_t view = document.add_view(*bytes);
    Json& image = document.json.at("images").at(i);
    image.erase("uri");
    image["bufferView"] = view;
    image["mimeType"] = type;
  }
}

}  // namespace

std::string media_type_of(std::span<const std::uint8_t> image) {
  const auto starts_with = [&](std::string_view start) {
    return image.size() > start.size() &&
           std::memcmp(image.data(), start.data(), start.size()) == 0;
  };
  if (starts_with("\x89PNG\r\n\x1a\n")) return "image/png";
  if (starts_with("\xff\xd8\xff")) return "image/jpeg";
  if (gltf::is_webp(image)) return "image/webp";
  return "";
}

void write_extras(Json& mesh, const KernelFile& kernels, const Eigen::Vector3d& up) {
  Json& extras = mesh["extras"];
  if (!extras.is_object()) extras = Json::object();
  extras[std::string(kKernelUpKey)] = {up.x(), up.y(), up.z()};
  extras.erase(std::string(kKernelGeometryKey));
  if (!kernels.geometry.empty()) extras[std::string(kKernelGeometryKey)] = kernels.geometry;
  extras.erase(std::string(kKernelGroupsKey));
  if (kernels.groups.empty()) return;
  Json& groups = extras[std::string(kKernelGroupsKey)] = Json::array();
  for (const std::string& group : kernels.groups) groups.push_back(as_utf8(group));
}

Result<GlbDocument> GlbDocument::open(const std::filesystem::path& file,
                                      std::vector<std::string>& warnings) {
  const std::string name = file.string();
  const std::size_t max_bytes = ModelLimits().max_file_bytes;
  PENUMBRA_TRY(const auto bytes, read_file(file, max_bytes));
  gltf::Container container{{reinterpret_cast<const char*>(bytes.data()), bytes.size()}, {}};
  if (container.json.starts_with("glTF")) {
    PENUMBRA_TRY(auto opened, gltf::open_glb(name, bytes));
    container = opened;
  } else {
    PENUMBRA_TRY(container.json, without_byte_order_mark(container.json, name));
  }
  PENUMBRA_TRY(auto parsed, gltf::parse_document(name, container.json));
  gltf::Buffers buffers(file, std::move(parsed.buffers), container.binary, max_bytes);
  GlbDocument document;
  document.json = Json::parse(container.json);
  auto binary = joined_buffers(document.json, buffers);
  if (!binary) return fail_in(name, binary.error());
  document.binary_ = std::move(*binary);
  embed_images(document, buffers, name, warnings);
  return document;
}

std::size_t GlbDocument::add_view(std::span<const std::uint8_t> bytes, std::optional<int> target) {
  while (binary_.size() % 4 != 0) binary_.push_back(0);
  Json view = {{"buffer", 0}, {"byteOffset", binary_.size()}, {"byteLength", bytes.size()}};
  if (target) view["target"] = *target;
  binary_.insert(binary_.end(), bytes.begin(), bytes.end());
  json["bufferViews"].push_back(std::move(view));
  return json["bufferViews"].size() - 1;
}

bool GlbDocument::overwrite(std::size_t offset, std::span<const glm::vec3> vectors) {
  if (offset > binary_.size() || vectors.size_bytes() > binary_.size() - offset) return false;
  std::memcpy(binary_.data() + offset, vectors.data(), vectors.size_bytes());
  return true;
}

Result<std::vector<std::uint8_t>> GlbDocument::finish() {
  while (binary_.size() % 4 != 0) binary_.push_back(0);
  Json& buffers = json["buffers"];
  if (!buffers.is_array() || buffers.empty()) buffers = Json::array({Json::object()});
  buffers[0]["byteLength"] = binary_.size();
  std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  while (text.size() % 4 != 0) text += ' ';
  const std::size_t length = 12 + 8 + text.size() + 8 + binary_.size();
  if (length > std::numeric_limits<std::uint32_t>::max()) {
    return fail("the .glb would be over 4 GB; store the kernels in a .json file");
  }
  std::vector<std::uint8_t> file;
  file.reserve(length);
  const auto append_word = [&file](std::size_t value) {
    std::array<std::uint8_t, 4> bytes{};
    for (unsigned i = 0; i < 4; ++i) bytes[i] = static_cast<std::uint8_t>(value >> (8 * i));
    file.insert(file.end(), bytes.begin(), bytes.end());
  };
  append_word(kMagic);
  append_word(2);
  append_word(length);
  append_word(text.size());
  append_word(kJsonChunk);
  file.insert(file.end(), text.begin(), text.end());
  append_word(binary_.size());
  append_word(kBinaryChunk);
  file.insert(file.end(), binary_.begin(), binary_.end());
  return file;
}

}  // namespace penumbra
