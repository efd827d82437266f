// .glb and .gltf -> Model, through tinygltf: it reads the JSON and fetches buffers.
#include <optional>

#include "core/file.hpp"
#include "render/gltf/container.hpp"
#include "render/gltf/gltf_reader.hpp"
#include "render/model_parts.hpp"

namespace penumbra {
namespace {

// tinygltf is told this folder; the file callbacks put the model's own in its place.
constexpr std::string_view kModelFolder = "model-folder:";

// Files beside the model, for tinygltf's callbacks.
struct Neighbours {
  std::filesystem::path folder;
  std::size_t bytes_left = 0;
  std::string refused;  // why the last file could not be had

  [[nodiscard]] std::optional<std::filesystem::path> find(const std::string& path) {
    if (!path.starts_with(kModelFolder)) return std::nullopt;  // tinygltf's try in "."
    std::string_view name = std::string_view(path).substr(kModelFolder.size());
    if (name.starts_with('/')) name.remove_prefix(1);
    const Result<std::filesystem::path> file = beside_model(folder, name);
    if (!file) {
      refused = file.error().message;
      return std::nullopt;
    }
    if (!std::filesystem::is_regular_file(*file)) {
      refused = file->string() + ": not found; put it beside the model";
      return std::nullopt;
    }
    return *file;
  }
};

bool neighbour_exists(const std::string& path, void* user) {
  return static_cast<Neighbours*>(user)->find(path).has_value();
}

std::string same_path(const std::string& path, void*) {
  return path;
}

bool read_neighbour(std::vector<unsigned char>* bytes, std::string* error, const std::string& path,
                    void* user) {
  auto& neighbours = *static_cast<Neighbours*>(user);
  const auto file = neighbours.find(path);
  if (!file) return false;
  Result<std::vector<std::uint8_t>> read = read_file(*file, neighbours.bytes_left);
  if (!read) {
    neighbours.refused = read.error().message;
    if (error != nullptr) *error = neighbours.refused;
    return false;
  }
  neighbours.bytes_left -= read->size();
  *bytes = std::move(*read);
  return true;
}

bool write_nothing(std::string*, const std::string&, const std::vector<unsigned char>&, void*) {
  return false;
}

// Keeps a picture's coded bytes; decoding comes when a material uses it. Pictures in a buffer view
// are taken from there, after the view has been checked: the pointer given here has not been.
bool keep_picture(tinygltf::Image* image, const int, std::string*, std::string*, int, int,
                  const unsigned char* bytes, int size, void*) {
  if (image->bufferView < 0 && bytes != nullptr && size > 0)
    image->image.assign(bytes, bytes + size);
  return true;
}

// One line of a library's report.
std::string first_line(const std::string& text) {
  const std::string line = text.substr(0, text.find('\n'));
  return line.empty() ? "malformed" : line.substr(0, 200);
}

}  // namespace

Result<Model> read_gltf(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                        bool binary, const ModelLimits& limits) {
  const std::string name = file.string();
  std::string_view json(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (binary) {
    const Result<std::string_view> chunk = json_chunk(name, bytes);
    if (!chunk) return tl::unexpected(chunk.error());
    json = *chunk;
  }
  if (nesting_depth(json) > kMaxModelDepth) {
    return fail("{}: its JSON is nested deeper than {} levels", name, kMaxModelDepth);
  }
  Neighbours neighbours{file.parent_path(), limits.max_file_bytes, {}};
  tinygltf::TinyGLTF reader;
  reader.SetFsCallbacks({neighbour_exists, same_path, read_neighbour, write_nothing, &neighbours});
  reader.SetImageLoader(keep_picture, nullptr);
  tinygltf::Model gltf;
  std::string error, warning;
  const std::string folder(kModelFolder);
  const auto size = static_cast<unsigned int>(bytes.size());
  const bool read =
      binary
          ? reader.LoadBinaryFromMemory(&gltf, &error, &warning, bytes.data(), size, folder)
          : reader.LoadASCIIFromString(&gltf, &error, &warning,
                                       reinterpret_cast<const char*>(bytes.data()), size, folder);
  if (!read && !neighbours.refused.empty()) return fail("{}: {}", name, neighbours.refused);
  if (!read) return fail("{}: is not glTF 2.0: {}", name, first_line(error));
  if (!neighbours.refused.empty()) return fail("{}: {}", name, neighbours.refused);
  if (!gltf.asset.version.starts_with("2.") && gltf.asset.version != "2") {
    return fail("{}: asset: version is '{}'; only glTF 2.0 is read, export it as that", name,
                gltf.asset.version.substr(0, 20));
  }
  Result<Model> model = GltfReader(name, gltf, limits).read();
  if (model && !model->shadow_kernel_up) {
    for (Mesh& mesh : model->meshes)
      mesh.shadow_kernels.clear();  // nobody knows for which direction
  }
  return model;
}

}  // namespace penumbra
