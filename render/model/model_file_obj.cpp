// OBJ with its .mtl -> Model, in the file's own axes. Numbers are read in double.
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>

#include "core/propagate.hpp"
#include "core/text/text_encoding.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/obj_parts.hpp"

namespace penumbra {
namespace {

constexpr double kMaxTexcoord = 1e6;
constexpr double kLeastNormal = 1e-30;  // floats hold its parts
constexpr double kGreatestNormal = 1e30;

bool continues(std::string_view line) {
  if (line.ends_with('\r')) line.remove_suffix(1);
  return line.ends_with('\\');
}
bool is_comment(std::string_view line) {
  const std::size_t first = line.find_first_not_of(" \t");
  return first != std::string_view::npos && line[first] == '#';
}

constexpr std::array<std::string_view, 2> kNoSurface = {"l", "p"};
constexpr std::array<std::string_view, 20> kFreeForm = {
    "vp",   "cstype", "deg", "bmat", "step", "curv", "curv2", "surf", "parm", "trim",
    "hole", "scrv",   "sp",  "end",  "con",  "res",  "bsp",   "bzp",  "cdc",  "cdp"};
constexpr std::array<std::string_view, 12> kObjWithoutEffect = {
    "s",      "mg",     "bevel",      "c_interp",  "d_interp", "lod",
    "usemap", "maplib", "shadow_obj", "trace_obj", "ctech",    "stech"};
constexpr std::array<std::string_view, 3> kMissing = {
    "", "a face names a texture coordinate that is not there; it has none",
    "a face names a normal that is not there; it is computed from the faces"};

class ObjReader {
 public:
  ObjReader(const std::filesystem::path& file, const ModelLimits& limits)
      : name_(file.string()), limits_(limits), materials_(file, limits), warnings_(name_) {}

  [[nodiscard]] Result<Model> read(std::string_view text);
  [[nodiscard]] double file_step() const { return obj_.step; }

 private:
  [[nodiscard]] Result<void> read_lines(std::string_view text);
  [[nodiscard]] Result<void> read_line(std::string_view line);
  [[nodiscard]] Result<void> read_position(const std::vector<std::string_view>& words);
  void read_texcoord(const std::vector<std::string_view>& words);
  void read_normal(const std::vector<std::string_view>& words);
  [[nodiscard]] Result<void> read_face(const std::vector<std::string_view>& words);
  [[nodiscard]] Result<ObjCorner> read_corner(std::string_view word);
  void use_material(std::string_view name);
  [[nodiscard]] Result<void> check_indices();
  [[nodiscard]] std::vector<int> find_materials();

  std::string name_;
  const ModelLimits& limits_;
  std::size_t line_ = 0;
  ObjFile obj_;
  ObjMaterials materials_;
  LineWarnings warnings_;
  std::map<std::string, std::int32_t> material_index_;  // into ObjFile::material_names
  std::int32_t material_ = -1;
  std::string node_name_;
  bool node_has_faces_ = false;
  std::size_t without_surface_ = 0;  // lines and points
  Model model_;
};

Result<void> ObjReader::read_position(const std::vector<std::string_view>& words) {
  if (words.size() < 4) {
    return fail("{}: line {}: \"v\" has {} numbers; 3 are needed", name_, line_, words.size() - 1);
  }
  Eigen::Vector3d position;
  for (std::size_t i = 1; i < 4; ++i) {
    const std::optional<double> value = finite_number(words[i]);
    if (!value && has_decimal_comma(words[i])) {
      return fail(
          "{}: line {}: \"{}\" has a decimal comma; export the model with decimal points, or "
          "replace the decimal commas by points",
          name_, line_, words[i].substr(0, 40));
    }
    if (!value) {
      return fail("{}: line {}: \"{}\" is not a finite number; export the model again", name_,
                  line_, words[i].substr(0, 40));
    }
    if (std::abs(*value) > kMaxFileCoordinate_m) {
      return fail("{}: line {}: {} is over the {} allowed; move the model to the origin", name_,
                  line_, *value, kMaxFileCoordinate_m);
    }
    position[static_cast<Eigen::Index>(i) - 1] = *value;
  }
  if (obj_.positions.size() >= limits_.max_vertices) {
    return fail("{}: line {}: more than the {} vertices allowed", name_, line_,
                limits_.max_vertices);
  }
  obj_.positions.push_back(position);
  // x y z [w] or x y z r g b [...]
  if (words.size() >= 7) {
    glm::vec3 color(1.0F);
    bool finite = true;
    for (std::size_t i = 4; i < 7; ++i) {
      const std::optional<double> value = finite_number(words[i]);
      finite = finite && value;
      if (value) color[static_cast<int>(i) - 4] = static_cast<float>(std::clamp(*value, 0.0, 1.0));
    }
    if (finite) {
      obj_.colors.resize(obj_.positions.size() - 1, glm::vec3(1.0F));
      obj_.colors.push_back(color);
    } else {
      warnings_.add(line_, "a vertex colour is not of finite numbers and is ignored");
    }
  }
  return {};
}

// Every line counts, so that the indices of faces stay right: one that can't be read is (0, 0).
void ObjReader::read_texcoord(const std::vector<std::string_view>& words) {
  glm::vec2 texcoord(0.0F);
  bool good = words.size() > 1;
  for (std::size_t i = 1; i < std::min<std::size_t>(words.size(), 3); ++i) {
    const std::optional<double> value = finite_number(words[i]);
    good = good && value && std::abs(*value) <= kMaxTexcoord;
    if (good) texcoord[static_cast<int>(i) - 1] = static_cast<float>(*value);
  }
  if (!good) {
    warnings_.add(line_, "a texture coordinate is not of numbers within +-1e6 and taken as 0 0");
    texcoord = glm::vec2(0.0F);
  }
  obj_.texcoords.push_back(texcoord);
}

// A normal that can't be read is zero, which means none.
void ObjReader::read_normal(const std::vector<std::string_view>& words) {
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  for (std::size_t i = 1; i < 4 && i < words.size(); ++i) {
    normal[static_cast<Eigen::Index>(i) - 1] =
        finite_number(words[i]).value_or(std::numeric_limits<double>::quiet_NaN());
  }
  const double largest = normal.cwiseAbs().maxCoeff();
  if (words.size() < 4 || !normal.allFinite() || largest == 0.0) {
    warnings_.add(line_, "a normal is not a direction; it is computed from the faces");
    normal.setZero();
  } else if (!(largest >= kLeastNormal && largest <= kGreatestNormal)) {
    normal = (normal / largest).normalized();
  }
  obj_.normals.emplace_back(static_cast<float>(normal.x()), static_cast<float>(normal.y()),
                            static_cast<float>(normal.z()));
}

// v, v/vt, v//vn, v/vt/vn; what is empty or 0 behind v is not there. Positive indices may be of
// what comes later: they are checked at the end.
Result<ObjCorner> ObjReader::read_corner(std::string_view word) {
  const auto wrong = [&] {
    return fail("{}: line {}: \"{}\" is not a corner of a face (v, v/vt, v//vn, v/vt/vn)", name_,
                line_, word.substr(0, 40));
  };
  const std::array<std::size_t, 3> known = {obj_.positions.size(), obj_.texcoords.size(),
                                            obj_.normals.size()};
  std::array<std::int32_t, 3> indices = {-1, -1, -1};
  std::string_view rest = word;
  for (std::size_t part = 0; part < 3; ++part) {
    const std::size_t slash = rest.find('/');
    std::string_view text = rest.substr(0, slash);
    if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
    std::int64_t value = 0;
    if (!text.empty() || part == 0) {
      const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
      if (error != std::errc() || end != text.data() + text.size()) return wrong();
      const std::int64_t index =
          value > 0 ? value - 1 : static_cast<std::int64_t>(known[part]) + value;
      const bool exists =
          value != 0 && index >= 0 && index < std::numeric_limits<std::int32_t>::max();
      if (part == 0 && !exists) return wrong();
      if (exists) indices[part] = static_cast<std::int32_t>(index);
      if (!exists && value != 0) {
        warnings_.add(line_, kMissing[part]);
      }
    }
    if (slash == std::string_view::npos) break;
    rest.remove_prefix(slash + 1);
    if (part == 2) return wrong();
  }
  return ObjCorner{indices[0], indices[1], indices[2]};
}

Result<void> ObjReader::read_face(const std::vector<std::string_view>& words) {
  ObjFace face;
  face.first_corner = obj_.corners.size();
  for (std::size_t i = 1; i < words.size(); ++i) {
    PENUMBRA_TRY(const ObjCorner corner, read_corner(words[i]));
    obj_.corners.push_back(corner);
  }
  if (obj_.corners.size() > 3 * limits_.max_triangles + 2) {
    return fail("{}: line {}: more than the {} triangles allowed", name_, line_,
                limits_.max_triangles);
  }
  face.corner_count = static_cast<std::uint32_t>(obj_.corners.size() - face.first_corner);
  if (face.corner_count < 3) {
    warnings_.add(line_, "a face has fewer than 3 corners and is skipped");
    obj_.corners.resize(face.first_corner);
    return {};
  }
  if (!node_has_faces_) obj_.nodes.push_back({node_name_, "", -1});
  node_has_faces_ = true;
  face.node = static_cast<std::uint32_t>(obj_.nodes.size()) - 1;
  face.material = material_;
  face.line = static_cast<std::uint32_t>(line_);
  obj_.faces.push_back(face);
  return {};
}

void ObjReader::use_material(std::string_view name) {
  const auto [entry, is_new] = material_index_.try_emplace(
      as_utf8(name), static_cast<std::int32_t>(obj_.material_names.size()));
  if (is_new) obj_.material_names.push_back(entry->first);
  material_ = entry->second;
}

Result<void> ObjReader::read_line(std::string_view line) {
  const std::vector<std::string_view> words = obj_words(line);
  if (words.empty()) return {};
  const std::string_view key = words[0];
  if (key == "v") return read_position(words);
  if (key == "f" || key == "fo") return read_face(words);
  if (key == "vt") {
    read_texcoord(words);
  } else if (key == "vn") {
    read_normal(words);
  } else if (key == "usemtl") {
    use_material(after_keyword(line));
  } else if (key == "mtllib") {
    materials_.read_files(after_keyword(line), line_);
  } else if (key == "o" || key == "g") {
    node_name_ = as_utf8(after_keyword(line));
    node_has_faces_ = false;
  } else if (is_one_of(key, kNoSurface)) {
    ++without_surface_;
    warnings_.add(line_, "lines and points have no surface and are skipped");
  } else if (is_one_of(key, kFreeForm)) {
    warnings_.add(line_, "free-form curves and surfaces are skipped; export them as faces");
  } else if (!is_one_of(key, kObjWithoutEffect)) {
    warnings_.add(line_, "a line does not start with a word of the OBJ format and is skipped");
  }
  if (obj_.texcoords.size() > 3 * limits_.max_vertices) {
    return fail("{}: line {}: too many texture coordinates", name_, line_);
  }
  if (obj_.normals.size() > 3 * limits_.max_vertices) {
    return fail("{}: line {}: too many normals", name_, line_);
  }
  return {};
}

Result<void> ObjReader::read_lines(std::string_view text) {
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
    if (Result<void> read = read_line(line); !read) return read;
  }
  if (obj_.faces.empty()) {
    return fail("{}: has no faces{}; is this an OBJ file, and was it exported with its faces?",
                name_,
                without_surface_ == 0
                    ? std::string()
                    : fmt::format(", but {} lines and points without a surface", without_surface_));
  }
  return {};
}

// A vertex must be there; a texture coordinate or normal that is not there is none.
Result<void> ObjReader::check_indices() {
  const auto is_missing = [](std::int32_t index, std::size_t known) {
    return index >= 0 && static_cast<std::size_t>(index) >= known;
  };
  for (const ObjFace& face : obj_.faces) {
    for (std::size_t i = 0; i < face.corner_count; ++i) {
      ObjCorner& corner = obj_.corners[face.first_corner + i];
      if (is_missing(corner.position, obj_.positions.size())) {
        return fail("{}: line {}: a face names vertex {}, there are {}", name_, face.line,
                    corner.position + 1, obj_.positions.size());
      }
      if (is_missing(corner.texcoord, obj_.texcoords.size())) {
        warnings_.add(face.line, kMissing[1]);
        corner.texcoord = -1;
      }
      if (is_missing(corner.normal, obj_.normals.size())) {
        warnings_.add(face.line, kMissing[2]);
        corner.normal = -1;
      } else if (corner.normal >= 0 &&
                 obj_.normals[static_cast<std::size_t>(corner.normal)] == glm::vec3(0.0F)) {
        corner.normal = -1;
      }
    }
  }
  return {};
}

// Gives the model the materials; per name of a material its index there.
std::vector<int> ObjReader::find_materials() {
  std::vector<bool> named(obj_.material_names.size(), false);
  for (const ObjFace& face : obj_.faces) {
    if (face.material >= 0) named[static_cast<std::size_t>(face.material)] = true;
  }
  const auto plain = static_cast<int>(materials_.size());
  std::vector<int> found(named.size(), plain);
  std::vector<bool> used(materials_.size(), false);
  std::string unknown;
  std::size_t unknown_count = 0;
  for (std::size_t i = 0; i < named.size(); ++i) {
    const std::string& name = obj_.material_names[i];
    std::optional<std::size_t> index = materials_.find(name);
    // A comment may follow the name.
    if (!index) index = materials_.find(name.substr(0, name.find(" #")));
    if (index) {
      found[i] = static_cast<int>(*index);
      used[*index] = used[*index] || named[i];
    } else if (named[i] && unknown_count++ == 0) {
      unknown = name;
    }
  }
  materials_.give_to(model_, used);
  if (unknown_count > 0 && !materials_.is_incomplete()) {
    model_.warnings.push_back(fmt::format(
        "{}: material \"{}\"{} is in no material file of the model; its faces are drawn in plain "
        "grey",
        name_, as_utf8(unknown.substr(0, 60)),
        unknown_count > 1 ? fmt::format(" (one of {})", unknown_count) : ""));
  }
  return found;
}

Result<Model> ObjReader::read(std::string_view text) {
  PENUMBRA_TRY(const std::string_view plain, without_byte_order_mark(text, name_));
  PENUMBRA_TRY_VOID(read_lines(plain));
  if (!obj_.colors.empty()) obj_.colors.resize(obj_.positions.size(), glm::vec3(1.0F));
  PENUMBRA_TRY_VOID(check_indices());
  const std::vector<int> materials = find_materials();
  PENUMBRA_TRY_VOID(add_obj_meshes(model_, obj_, materials, warnings_, limits_, name_));
  model_.nodes = std::move(obj_.nodes);
  warnings_.append_to(model_.warnings);
  return std::move(model_);
}

}  // namespace

Result<Model> read_obj(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                       const ModelLimits& limits, double& file_step) {
  ObjReader reader(file, limits);
  Result<Model> model = reader.read({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  file_step = reader.file_step();
  return model;
}

}  // namespace penumbra
