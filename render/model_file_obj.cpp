// OBJ with its .mtl -> Model, through tinyobjloader, in the file's own axes. tinyobjloader reads
// `nan` as 0 and lets indices out of range through, so every line is checked before it, and only
// the lines that are understood here are handed on.
#include <tiny_obj_loader.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <limits>
#include <map>
#include <optional>
#include <unordered_map>

#include "core/file.hpp"
#include "render/model_parts.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxFaceCorners = 255;  // tinyobjloader counts them in a byte
constexpr std::size_t kMaxMaterials = 10'000;
constexpr double kCreaseCosine = 0.7071;  // faces that meet at over 45 degrees have an edge

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  std::size_t at = 0;
  while (true) {
    at = line.find_first_not_of(" \t\r", at);
    if (at == std::string_view::npos) return words;
    const std::size_t end = std::min(line.find_first_of(" \t\r", at), line.size());
    words.push_back(line.substr(at, end - at));
    at = end;
  }
}

bool continues(std::string_view line) {
  if (line.ends_with('\r')) line.remove_suffix(1);
  return line.ends_with('\\');
}
bool is_comment(std::string_view line) {
  const std::size_t first = line.find_first_not_of(" \t");
  return first != std::string_view::npos && line[first] == '#';
}

std::optional<double> finite_number(std::string_view word) {
  if (word.starts_with('+')) word.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

// One-based or negative (relative to what came before) -> zero-based; nothing where it is neither.
std::optional<std::int64_t> zero_based(std::string_view word, std::size_t known) {
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size() || value == 0) return std::nullopt;
  const std::int64_t index = value > 0 ? value - 1 : static_cast<std::int64_t>(known) + value;
  if (index < 0 || index > std::numeric_limits<int>::max()) return std::nullopt;
  return index;
}

class ObjReader {
 public:
  ObjReader(const std::filesystem::path& file, const ModelLimits& limits)
      : file_(file), name_(file.string()), limits_(limits) {}

  [[nodiscard]] Result<Model> read(std::string_view text);

 private:
  struct Counts {
    std::size_t positions = 0, texcoords = 0, normals = 0;
  };

  [[nodiscard]] Result<void> check_lines(std::string_view text);
  [[nodiscard]] Result<void> check_numbers(const std::vector<std::string_view>& words,
                                           std::size_t least, std::size_t most);
  [[nodiscard]] Result<void> check_face(const std::vector<std::string_view>& words);
  [[nodiscard]] Result<void> read_material_file(std::string_view line);
  [[nodiscard]] Result<void> take_materials(const std::vector<tinyobj::material_t>& materials);
  [[nodiscard]] Result<void> take_faces(const tinyobj::attrib_t& attributes,
                                        const std::vector<tinyobj::shape_t>& shapes);

  std::filesystem::path file_;
  std::string name_;
  const ModelLimits& limits_;
  std::size_t line_ = 0;
  Counts counts_;                                    // so far
  std::array<std::int64_t, 3> highest_{-1, -1, -1};  // index named by a face: v, vt, vn
  std::array<std::size_t, 3> highest_line_{0, 0, 0};
  std::size_t corners_ = 0;
  bool has_colors_ = false;
  std::string obj_, mtl_;  // what tinyobjloader gets
  Model model_;
};

Result<void> ObjReader::check_numbers(const std::vector<std::string_view>& words, std::size_t least,
                                      std::size_t most) {
  if (words.size() - 1 < least || words.size() - 1 > most) {
    return fail("{}: line {}: \"{}\" has {} numbers; {} to {} expected", name_, line_, words[0],
                words.size() - 1, least, most);
  }
  for (std::size_t i = 1; i < words.size(); ++i) {
    const std::optional<double> value = finite_number(words[i]);
    if (!value) {
      return fail("{}: line {}: \"{}\" is not a finite number; export the model again", name_,
                  line_, words[i].substr(0, 40));
    }
    if (std::abs(*value) > std::max(limits_.max_coordinate_m, 1e6)) {
      return fail("{}: line {}: {} is over the {} allowed", name_, line_, *value,
                  std::max(limits_.max_coordinate_m, 1e6));
    }
  }
  return {};
}

Result<void> ObjReader::check_face(const std::vector<std::string_view>& words) {
  const std::size_t corners = words.size() - 1;
  if (corners < 3 || corners > kMaxFaceCorners) {
    return fail("{}: line {}: a face has {} corners; 3 to {} can be read", name_, line_, corners,
                kMaxFaceCorners);
  }
  const std::array<std::size_t, 3> known = {counts_.positions, counts_.texcoords, counts_.normals};
  for (std::size_t i = 1; i < words.size(); ++i) {
    std::string_view rest = words[i];
    for (std::size_t part = 0; part < 3; ++part) {
      const std::size_t slash = rest.find('/');
      const std::string_view word = rest.substr(0, slash);
      // v, v/vt, v//vn, v/vt/vn
      const bool may_be_empty = part == 1 && slash != std::string_view::npos;
      if (!(word.empty() && may_be_empty)) {
        const std::optional<std::int64_t> index = zero_based(word, known[part]);
        if (!index) {
          return fail("{}: line {}: \"{}\" is not a corner of a face (v, v/vt, v//vn, v/vt/vn)",
                      name_, line_, words[i].substr(0, 40));
        }
        if (*index > highest_[part]) {
          highest_[part] = *index;
          highest_line_[part] = line_;
        }
      }
      if (slash == std::string_view::npos) break;
      if (part == 2) {
        return fail("{}: line {}: \"{}\" is not a corner of a face (v, v/vt, v//vn, v/vt/vn)",
                    name_, line_, words[i].substr(0, 40));
      }
      rest.remove_prefix(slash + 1);
    }
  }
  corners_ += corners;
  if (corners_ - 2 > 3 * limits_.max_triangles) {
    return fail("{}: line {}: more than the {} triangles allowed", name_, line_,
                limits_.max_triangles);
  }
  return {};
}

// Numbers of a .mtl are as untrusted as those of the model.
Result<void> ObjReader::read_material_file(std::string_view line) {
  std::string_view named = line.substr(std::strlen("mtllib"));
  const std::size_t first = named.find_first_not_of(" \t");
  const std::size_t last = named.find_last_not_of(" \t\r");
  if (first == std::string_view::npos) return {};
  named = named.substr(first, last - first + 1);
  const Result<std::filesystem::path> file = beside_model(file_.parent_path(), named);
  if (!file) return fail("{}: line {}: {}", name_, line_, file.error().message);
  // Models are often passed on without it.
  if (!std::filesystem::exists(*file)) {
    model_.warnings.push_back(
        fmt::format("{}: line {}: there is no {}; its materials are drawn in plain grey", name_,
                    line_, file->string()));
    return {};
  }
  const Result<std::vector<std::uint8_t>> bytes = read_file(*file, limits_.max_file_bytes);
  if (!bytes) return fail("{}: line {}: {}", name_, line_, bytes.error().message);
  const std::string_view text(reinterpret_cast<const char*>(bytes->data()), bytes->size());
  std::size_t number = 0, materials = 0;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string_view mtl_line = text.substr(at, end - at);
    at = end + 1;
    ++number;
    const std::vector<std::string_view> words = words_of(mtl_line);
    if (words.empty()) continue;
    const std::string_view key = words[0];
    const bool color = key == "Kd" || key == "Ke";
    const bool factor = key == "Pr" || key == "Pm" || key == "d" || key == "Tr";
    if (color || factor) {
      if (words.size() != (color ? 4U : 2U)) {
        return fail("{}: line {}: {} has {} numbers", file->string(), number, key,
                    words.size() - 1);
      }
      for (std::size_t i = 1; i < words.size(); ++i) {
        const std::optional<double> value = finite_number(words[i]);
        if (!value || *value < 0.0 || *value > 1e6) {
          return fail("{}: line {}: \"{}\" is not a finite number from 0", file->string(), number,
                      words[i].substr(0, 40));
        }
      }
    } else if (key == "newmtl") {
      if (++materials > kMaxMaterials) {
        return fail("{}: has more than {} materials", file->string(), kMaxMaterials);
      }
    } else if (key != "map_Kd") {
      continue;
    }
    mtl_ += mtl_line;
    mtl_ += '\n';
  }
  return {};
}

Result<void> ObjReader::check_lines(std::string_view text) {
  // One list of materials, however many files it came from.
  obj_ = "mtllib materials\n";
  std::string joined;
  std::size_t next_line = 1;
  for (std::size_t at = 0; at < text.size();) {
    std::string_view line = text.substr(at, text.find('\n', at) - at);
    at += line.size() + 1;
    line_ = next_line++;
    // A backslash at the end: the next line belongs to this one. Not of a comment, where it may be
    // the end of a path.
    if (continues(line) && !is_comment(line)) {
      joined.clear();
      while (continues(line)) {
        joined += line.substr(0, line.rfind('\\'));
        joined += ' ';
        if (at >= text.size()) {
          line = {};
          break;
        }
        line = text.substr(at, text.find('\n', at) - at);
        at += line.size() + 1;
        ++next_line;
      }
      joined += line;
      line = joined;
    }
    if (line.find('\0') != std::string_view::npos) {
      return fail("{}: line {}: is not text; is this an OBJ file?", name_, line_);
    }
    const std::vector<std::string_view> words = words_of(line);
    if (words.empty() || words[0].starts_with('#')) continue;
    const std::string_view key = words[0];
    Result<void> checked;
    bool hand_on = true;
    if (key == "v") {
      checked = check_numbers(words, 3, 7);
      has_colors_ = has_colors_ || words.size() == 7 || words.size() == 8;
      if (++counts_.positions > limits_.max_vertices) {
        return fail("{}: line {}: more than the {} vertices allowed", name_, line_,
                    limits_.max_vertices);
      }
    } else if (key == "vt") {
      checked = check_numbers(words, 1, 3);
      if (++counts_.texcoords > limits_.max_vertices * 3) {
        return fail("{}: line {}: too many texture coordinates", name_, line_);
      }
    } else if (key == "vn") {
      checked = check_numbers(words, 3, 3);
      if (++counts_.normals > limits_.max_vertices * 3) {
        return fail("{}: line {}: too many normals", name_, line_);
      }
    } else if (key == "f") {
      checked = check_face(words);
    } else if (key == "mtllib") {
      checked = read_material_file(line.substr(line.find("mtllib")));
      hand_on = false;
    } else {
      // Names of objects and groups are kept; smoothing changes nothing here; lines, points and
      // curves have no surface.
      hand_on = key == "usemtl" || key == "o" || key == "g";
    }
    if (!checked) return checked;
    if (hand_on) {
      for (const std::string_view word : words) {
        obj_ += word;
        obj_ += ' ';
      }
      obj_.back() = '\n';
    }
  }
  const std::array<std::size_t, 3> known = {counts_.positions, counts_.texcoords, counts_.normals};
  constexpr std::array<std::string_view, 3> kinds = {"vertex", "texture coordinate", "normal"};
  for (std::size_t part = 0; part < 3; ++part) {
    if (highest_[part] >= static_cast<std::int64_t>(known[part])) {
      return fail("{}: line {}: a face names {} {}, there are {}", name_, highest_line_[part],
                  kinds[part], highest_[part] + 1, known[part]);
    }
  }
  if (corners_ == 0) {
    return fail("{}: has no faces; is this an OBJ file, and was it exported with its faces?",
                name_);
  }
  return {};
}

Result<void> ObjReader::take_materials(const std::vector<tinyobj::material_t>& materials) {
  const auto display = [](double value) {
    return linear_from_srgb(static_cast<float>(std::clamp(value, 0.0, 1.0)));
  };
  std::map<std::string, int> pictures;
  for (const tinyobj::material_t& from : materials) {
    Material material;
    material.name = from.name;
    // The format says nothing of light; painting programs mean colours as the screen shows them.
    for (int c = 0; c < 3; ++c) {
      material.base_color[c] = display(static_cast<double>(from.diffuse[c]));
      material.emissive[c] = display(static_cast<double>(from.emission[c]));
    }
    material.base_color.a = static_cast<float>(std::clamp<double>(from.dissolve, 0.0, 1.0));
    if (from.roughness > 0) {
      material.roughness = static_cast<float>(std::min<double>(from.roughness, 1.0));
    }
    material.metallic = static_cast<float>(std::clamp<double>(from.metallic, 0.0, 1.0));
    material.double_sided = true;  // OBJ has no rule for which side of a face is seen
    const std::string& picture = from.diffuse_texname;
    if (!picture.empty()) {
      const auto known = pictures.find(picture);
      if (known != pictures.end()) {
        material.base_color_texture.image = known->second;
      } else {
        const Result<std::filesystem::path> file = beside_model(file_.parent_path(), picture);
        if (!file) {
          return fail("{}: material \"{}\": {}", name_, from.name, file.error().message);
        }
        const Result<std::vector<std::uint8_t>> bytes = read_file(*file, limits_.max_file_bytes);
        if (!bytes) {
          return fail("{}: material \"{}\": {}", name_, from.name, bytes.error().message);
        }
        const Result<int> added = add_texture(model_, *bytes, file->string(), limits_);
        if (!added) return tl::unexpected(added.error());
        pictures.emplace(picture, *added);
        material.base_color_texture.image = *added;
      }
      // The picture is the colour; many exporters leave a dark Kd beside it.
      material.base_color = glm::vec4(1.0F, 1.0F, 1.0F, material.base_color.a);
    }
    if (material.base_color.a < 1.0F) material.alpha_mode = AlphaMode::blend;
    model_.materials.push_back(std::move(material));
  }
  Material plain;
  plain.name = "default";
  plain.base_color = glm::vec4(0.6F, 0.6F, 0.6F, 1.0F);
  plain.double_sided = true;
  model_.materials.push_back(plain);
  return {};
}

// Per corner the normal that a file without normals gets: faces that share the vertex and meet at
// a flat angle are smoothed together, sharp edges stay sharp.
std::vector<glm::vec3> creased_normals(const std::vector<glm::vec3>& positions,
                                       const std::vector<std::uint32_t>& corners) {
  // Beyond this many faces at a vertex all are smoothed: comparing all pairs would take hours.
  constexpr std::uint32_t kMaxPairedFaces = 64;
  struct Corner {
    glm::dvec3 normal{0.0};  // unit
    double angle = 0.0;
  };
  std::vector<Corner> faces(corners.size());
  std::vector<std::uint32_t> start(positions.size() + 1, 0);
  for (std::size_t t = 0; t < corners.size(); t += 3) {
    std::array<glm::dvec3, 3> p;
    for (std::size_t k = 0; k < 3; ++k) p[k] = glm::dvec3(positions[corners[t + k]]);
    const glm::dvec3 normal = glm::cross(p[1] - p[0], p[2] - p[0]);
    const double length = glm::length(normal);
    for (std::size_t k = 0; k < 3; ++k) {
      ++start[corners[t + k] + 1];
      if (!(length > 0.0)) continue;
      const glm::dvec3 a = p[(k + 1) % 3] - p[k], b = p[(k + 2) % 3] - p[k];
      const double cosine = glm::dot(a, b) / (glm::length(a) * glm::length(b));
      faces[t + k] = {normal / length, std::acos(std::clamp(cosine, -1.0, 1.0))};
    }
  }
  for (std::size_t i = 1; i < start.size(); ++i) start[i] += start[i - 1];
  std::vector<std::uint32_t> at_vertex(corners.size());
  std::vector<std::uint32_t> next(start.begin(), start.end() - 1);
  for (std::size_t c = 0; c < corners.size(); ++c) {
    at_vertex[next[corners[c]]++] = static_cast<std::uint32_t>(c);
  }
  std::vector<glm::vec3> normals(corners.size());
  for (std::size_t v = 0; v < positions.size(); ++v) {
    const bool all = start[v + 1] - start[v] > kMaxPairedFaces;
    glm::dvec3 sum(0.0);
    for (std::uint32_t i = start[v]; i < start[v + 1]; ++i) {
      const Corner& own = faces[at_vertex[i]];
      if (!all || i == start[v]) {
        sum = glm::dvec3(0.0);
        for (std::uint32_t j = start[v]; j < start[v + 1]; ++j) {
          const Corner& other = faces[at_vertex[j]];
          if (all || glm::dot(own.normal, other.normal) >= kCreaseCosine) {
            sum += other.normal * other.angle;
          }
        }
      }
      const double length = glm::length(sum);
      normals[at_vertex[i]] = length > 1e-9 ? glm::vec3(sum / length) : glm::vec3(own.normal);
    }
  }
  return normals;
}

Result<void> ObjReader::take_faces(const tinyobj::attrib_t& attributes,
                                   const std::vector<tinyobj::shape_t>& shapes) {
  const std::size_t known = attributes.vertices.size() / 3;
  const auto plain = static_cast<int>(model_.materials.size()) - 1;
  std::vector<glm::vec3> positions(known);
  for (std::size_t i = 0; i < known; ++i) {
    positions[i] = glm::vec3(attributes.vertices[3 * i], attributes.vertices[3 * i + 1],
                             attributes.vertices[3 * i + 2]);
  }
  // All triangles of the file, then one mesh per material.
  std::vector<tinyobj::index_t> corners;
  std::vector<int> materials;
  std::vector<std::uint32_t> nodes;  // of each triangle
  for (const tinyobj::shape_t& shape : shapes) {
    if (shape.mesh.indices.size() != 3 * shape.mesh.material_ids.size()) {
      return fail("{}: a face can't be split into triangles; export triangles", name_);
    }
    nodes.insert(nodes.end(), shape.mesh.material_ids.size(),
                 static_cast<std::uint32_t>(model_.nodes.size()));
    model_.nodes.push_back({shape.name, "", -1});
    corners.insert(corners.end(), shape.mesh.indices.begin(), shape.mesh.indices.end());
    for (const int material : shape.mesh.material_ids) {
      materials.push_back(material >= 0 && material < plain ? material : plain);
    }
  }
  std::vector<std::uint32_t> vertices;
  vertices.reserve(corners.size());
  for (const tinyobj::index_t& corner : corners) {
    const bool inside =
        corner.vertex_index >= 0 && static_cast<std::size_t>(corner.vertex_index) < known &&
        (corner.normal_index < 0 ||
         static_cast<std::size_t>(corner.normal_index) < attributes.normals.size() / 3) &&
        (corner.texcoord_index < 0 ||
         static_cast<std::size_t>(corner.texcoord_index) < attributes.texcoords.size() / 2);
    if (!inside) return fail("{}: a face names what does not exist", name_);
    vertices.push_back(static_cast<std::uint32_t>(corner.vertex_index));
  }
  const bool creased = std::any_of(corners.begin(), corners.end(),
                                   [](const tinyobj::index_t& c) { return c.normal_index < 0; });
  const std::vector<glm::vec3> generated =
      creased ? creased_normals(positions, vertices) : std::vector<glm::vec3>{};
  using Key = std::array<std::uint32_t, 5>;  // vertex, texture coordinate, normal's bits
  struct Hash {
    std::size_t operator()(const Key& key) const {
      std::uint64_t h = 1469598103934665603ULL;  // FNV-1a
      for (const std::uint32_t word : key) h = (h ^ word) * 1099511628211ULL;
      return static_cast<std::size_t>(h ^ (h >> 32U));
    }
  };
  struct Part {
    Mesh mesh;
    std::unordered_map<Key, std::uint32_t, Hash> known;
  };
  std::map<int, Part> parts;
  for (std::size_t t = 0; t < materials.size(); ++t) {
    Part& part = parts[materials[t]];
    std::array<std::uint32_t, 3> triangle{};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t c = 3 * t + k;
      const tinyobj::index_t& corner = corners[c];
      glm::vec3 normal(0.0F);
      if (corner.normal_index >= 0) {
        const auto n = 3 * static_cast<std::size_t>(corner.normal_index);
        normal =
            glm::vec3(attributes.normals[n], attributes.normals[n + 1], attributes.normals[n + 2]);
      } else {
        normal = generated[c];
      }
      Key key = {vertices[c], static_cast<std::uint32_t>(corner.texcoord_index), 0, 0, 0};
      std::memcpy(key.data() + 2, &normal, 3 * sizeof(float));
      Mesh& mesh = part.mesh;
      const auto [entry, is_new] =
          part.known.try_emplace(key, static_cast<std::uint32_t>(mesh.positions.size()));
      if (is_new) {
        mesh.positions.push_back(positions[vertices[c]]);
        mesh.normals.push_back(normal);
        mesh.source_vertex.push_back(vertices[c]);
        if (!attributes.texcoords.empty()) {
          glm::vec2 texcoord(0.0F);
          if (corner.texcoord_index >= 0) {
            const auto i = 2 * static_cast<std::size_t>(corner.texcoord_index);
            // OBJ counts v from the picture's bottom.
            texcoord = {attributes.texcoords[i], 1.0F - attributes.texcoords[i + 1]};
          }
          mesh.texcoords.push_back(texcoord);
        }
        if (has_colors_ && attributes.colors.size() >= 3 * known) {
          const auto i = 3 * static_cast<std::size_t>(vertices[c]);
          const auto display = [&](std::size_t channel) {
            return linear_from_srgb(
                std::clamp(static_cast<float>(attributes.colors[i + channel]), 0.0F, 1.0F));
          };
          mesh.colors.emplace_back(display(0), display(1), display(2), 1.0F);
        }
      }
      triangle[k] = entry->second;
    }
    // A face whose corners coincide stays: it covers nothing, but its vertices are the model's.
    std::vector<NodeFaces>& runs = part.mesh.node_faces;
    if (runs.empty() || runs.back().node != nodes[t]) {
      runs.push_back({nodes[t], part.mesh.indices.size(), 0});
    }
    runs.back().index_count += triangle.size();
    part.mesh.indices.insert(part.mesh.indices.end(), triangle.begin(), triangle.end());
  }
  for (auto& [material, part] : parts) {
    part.mesh.material = material;
    part.mesh.name = model_.materials[static_cast<std::size_t>(material)].name;
    model_.meshes.push_back(std::move(part.mesh));
  }
  model_.source_vertex_count = static_cast<std::uint32_t>(known);
  return {};
}

Result<Model> ObjReader::read(std::string_view text) {
  if (Result<void> checked = check_lines(text); !checked) return tl::unexpected(checked.error());
  tinyobj::ObjReader reader;
  tinyobj::ObjReaderConfig config;
  config.triangulate = true;
  config.vertex_color = has_colors_;
  if (!reader.ParseFromString(obj_, mtl_, config)) {
    return fail("{}: is not an OBJ file: {}", name_,
                reader.Error().substr(0, std::min<std::size_t>(reader.Error().find('\n'), 200)));
  }
  if (Result<void> done = take_materials(reader.GetMaterials()); !done) {
    return tl::unexpected(done.error());
  }
  if (Result<void> done = take_faces(reader.GetAttrib(), reader.GetShapes()); !done) {
    return tl::unexpected(done.error());
  }
  return std::move(model_);
}

}  // namespace

Result<Model> read_obj(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                       const ModelLimits& limits) {
  return ObjReader(file, limits).read({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace penumbra
