// Reads an OBJ file with its .mtl files, in the file's axes and in double precision.
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/obj_reader.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kBlanks = " \t\r\v\f";

// Returns true if a number outside the range of doubles underflows instead of overflows.
bool is_tiny(std::string_view number) {
  const std::size_t e = number.find_first_of("eE");
  const std::string_view mantissa = number.substr(0, e);
  const std::size_t point = std::min(mantissa.find('.'), mantissa.size());
  const std::size_t digit = std::min(mantissa.find_first_of("123456789"), mantissa.size());
  double power = static_cast<double>(point) - static_cast<double>(digit);
  if (e != std::string_view::npos) {
    std::string_view text = number.substr(e + 1);
    if (text.starts_with('+')) text.remove_prefix(1);
    std::int64_t exponent = 0;
    const auto error = std::from_chars(text.data(), text.data() + text.size(), exponent).ec;
    if (error != std::errc()) return text.starts_with('-');
    power += static_cast<double>(exponent);
  }
  return power < 0.0;
}

constexpr double kMaxTexcoord = 1e6;
constexpr double kMinNormal = 1e-30;  // normals outside these limits are scaled to fit into floats
constexpr double kMaxNormal = 1e30;

bool continues(std::string_view line) {
  if (line.ends_with('\r')) line.remove_suffix(1);
  return line.ends_with('\\');
}
bool is_comment(std::string_view line) {
  const std::size_t first = line.find_first_not_of(" \t");
  return first != std::string_view::npos && line[first] == '#';
}

constexpr std::array<std::string_view, 20> kFreeForm = {
    "vp",   "cstype", "deg", "bmat", "step", "curv", "curv2", "surf", "parm", "trim",
    "hole", "scrv",   "sp",  "end",  "con",  "res",  "bsp",   "bzp",  "cdc",  "cdp"};
constexpr std::array<std::string_view, 12> kObjWithoutEffect = {
    "s",      "mg",     "bevel",      "c_interp",  "d_interp", "lod",
    "usemap", "maplib", "shadow_obj", "trace_obj", "ctech",    "stech"};
constexpr std::string_view kMissingTexcoord =
    "a face names a texture coordinate that is not there; it has none";
constexpr std::string_view kMissingNormal =
    "a face names a normal that is not there; it is computed from the faces";

// Returns three numbers from words[first] on, or nullopt if one is absent or not finite.
std::optional<Eigen::Vector3d> vector_from(const std::vector<std::string_view>& words,
                                           std::size_t first) {
  Eigen::Vector3d vector;
  for (std::size_t i = 0; i < 3; ++i) {
    const auto value = first + i < words.size() ? finite_number(words[first + i]) : std::nullopt;
    if (!value) return std::nullopt;
    vector[static_cast<Eigen::Index>(i)] = *value;
  }
  return vector;
}

class ObjReader {
 public:
  ObjReader(const std::filesystem::path& file, const ModelLimits& limits)
      : name_(file.string()), limits_(limits), materials_(file, limits), warnings_(name_) {}

  [[nodiscard]] Result<Model> read(std::string_view text);
  [[nodiscard]] double file_step() const { return obj_.step; }

 private:
  [[nodiscard]] Result<void> read_lines(std::string_view text);
  // Errors of read_line() and the functions that it calls do not contain the file and the line.
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
  std::size_t without_surface_ = 0;  // number of lines and points
  Model model_;
};

Result<void> ObjReader::read_position(const std::vector<std::string_view>& words) {
  if (words.size() < 4) {
    return fail("\"v\" has {} numbers; 3 are needed", words.size() - 1);
  }
  Eigen::Vector3d position;
  for (std::size_t i = 1; i < 4; ++i) {
    const std::optional<double> value = finite_number(words[i]);
    if (!value && has_decimal_comma(words[i])) {
      return fail(
          "\"{}\" has a decimal comma; export the model with decimal points, or replace the "
          "decimal commas by points",
          shortened(words[i], 40));
    }
    if (!value) {
      return fail("\"{}\" is not a finite number; export the model again", shortened(words[i], 40));
    }
    if (std::abs(*value) > kMaxFileCoordinate) {
      return fail("{} is over the {} allowed; move the model to the origin", *value,
                  kMaxFileCoordinate);
    }
    position[static_cast<Eigen::Index>(i) - 1] = *value;
  }
  if (obj_.positions.size() >= limits_.max_vertices) {
    return fail("more than the {} vertices allowed", limits_.max_vertices);
  }
  obj_.positions.push_back(position);
  // x y z [w] or x y z r g b [...]
  if (words.size() < 7) return {};
  if (const auto color = vector_from(words, 4)) {
    obj_.colors.resize(obj_.positions.size() - 1, glm::vec3(1.0F));
    obj_.colors.push_back(
        to_glm(color->unaryExpr([](double c) { return std::clamp(c, 0.0, 1.0); })));
  } else {
    warnings_.add(line_, "a vertex colour is not of finite numbers and is ignored");
  }
  return {};
}

// Stores (0, 0) for an invalid line, because faces refer to texture coordinates by index.
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

// Stores zero, which means no normal, for an invalid line.
void ObjReader::read_normal(const std::vector<std::string_view>& words) {
  Eigen::Vector3d normal = vector_from(words, 1).value_or(Eigen::Vector3d::Zero());
  const double largest = normal.cwiseAbs().maxCoeff();
  if (largest == 0.0) {
    warnings_.add(line_, "a normal is not a direction; it is computed from the faces");
  } else if (!(largest >= kMinNormal && largest <= kMaxNormal)) {
    normal = (normal / largest).normalized();
  }
  obj_.normals.push_back(to_glm(normal));
}

// Reads v, v/vt, v//vn or v/vt/vn; an empty or zero vt or vn means none. Positive indices may refer
// to later lines, so check_indices() validates them.
Result<ObjCorner> ObjReader::read_corner(std::string_view word) {
  const auto wrong = [&] {
    return fail("\"{}\" is not a corner of a face (v, v/vt, v//vn, v/vt/vn)", shortened(word, 40));
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
        warnings_.add(line_, part == 1 ? kMissingTexcoord : kMissingNormal);
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
    return fail("more than the {} triangles allowed", limits_.max_triangles);
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
  } else if (key == "l" || key == "p") {
    ++without_surface_;
    warnings_.add(line_, "lines and points have no surface and are skipped");
  } else if (is_one_of(key, kFreeForm)) {
    warnings_.add(line_, "free-form curves and surfaces are skipped; export them as faces");
  } else if (!is_one_of(key, kObjWithoutEffect)) {
    warnings_.add(line_, "a line does not start with a word of the OBJ format and is skipped");
  }
  if (obj_.texcoords.size() > 3 * limits_.max_vertices) {
    return fail("too many texture coordinates");
  }
  if (obj_.normals.size() > 3 * limits_.max_vertices) return fail("too many normals");
  return {};
}

Result<void> ObjReader::read_lines(std::string_view text) {
  std::string joined;
  std::size_t next_line = 1;
  for (std::size_t at = 0; at < text.size();) {
    std::string_view line = text.substr(at, text.find('\n', at) - at);
    at += line.size() + 1;
    line_ = next_line++;
    // A backslash at the end continues the line, except in comments, where it may end a path.
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
    if (const Result<void> read = read_line(line); !read) {
      return fail("{}: line {}: {}", name_, line_, read.error().message);
    }
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

// Fails if a vertex does not exist; removes references to missing texture coordinates and normals.
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
        warnings_.add(face.line, kMissingTexcoord);
        corner.texcoord = -1;
      }
      if (is_missing(corner.normal, obj_.normals.size())) {
        warnings_.add(face.line, kMissingNormal);
        corner.normal = -1;
      } else if (corner.normal >= 0 &&
                 obj_.normals[static_cast<std::size_t>(corner.normal)] == glm::vec3(0.0F)) {
        corner.normal = -1;
      }
    }
  }
  return {};
}

// Moves the materials into the model. Returns an index into Model::materials per material name.
std::vector<int> ObjReader::find_materials() {
  std::vector<bool> used_names(obj_.material_names.size(), false);
  for (const ObjFace& face : obj_.faces) {
    if (face.material >= 0) used_names[static_cast<std::size_t>(face.material)] = true;
  }
  const auto default_material = static_cast<int>(materials_.size());  // added by move_to()
  std::vector<int> found(used_names.size(), default_material);
  std::vector<bool> used(materials_.size(), false);
  std::string unknown;
  std::size_t unknown_count = 0;
  for (std::size_t i = 0; i < used_names.size(); ++i) {
    const std::string& name = obj_.material_names[i];
    std::optional<std::size_t> index = materials_.find(name);
    // A comment may follow the name.
    if (!index) index = materials_.find(name.substr(0, name.find(" #")));
    if (index) {
      found[i] = static_cast<int>(*index);
      used[*index] = used[*index] || used_names[i];
    } else if (used_names[i] && unknown_count++ == 0) {
      unknown = name;
    }
  }
  materials_.move_to(model_, used);
  if (unknown_count > 0 && !materials_.is_incomplete()) {
    model_.warnings.push_back(fmt::format(
        "{}: material \"{}\"{} is in no material file of the model; its faces are drawn in plain "
        "grey",
        name_, as_utf8(shortened(unknown, 60)),
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

std::vector<std::string_view> obj_words(std::string_view line) {
  std::vector<std::string_view> words;
  std::size_t at = 0;
  while (true) {
    at = line.find_first_not_of(kBlanks, at);
    if (at == std::string_view::npos || line[at] == '#') return words;
    const std::size_t end = std::min(line.find_first_of(kBlanks, at), line.size());
    words.push_back(line.substr(at, end - at));
    at = end;
  }
}

std::string_view after_keyword(std::string_view line) {
  for (int word = 0; word < 2; ++word) {
    line.remove_prefix(std::min(line.find_first_not_of(kBlanks), line.size()));
    if (word == 0) line.remove_prefix(std::min(line.find_first_of(kBlanks), line.size()));
  }
  const std::size_t last = line.find_last_not_of(kBlanks);
  return line.substr(0, last == std::string_view::npos ? 0 : last + 1);
}

std::optional<double> finite_number(std::string_view word) {
  if (word.starts_with('+') && !word.starts_with("+-")) word.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error == std::errc::result_out_of_range && end == word.data() + word.size() &&
      is_tiny(word)) {
    return 0.0;
  }
  if (error != std::errc() || end != word.data() + word.size() || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

bool has_decimal_comma(std::string_view word) {
  const std::size_t comma = word.find(',');
  if (comma == std::string_view::npos) return false;
  std::string with_point(word);
  with_point[comma] = '.';
  return finite_number(with_point).has_value();
}

void LineWarnings::add(std::size_t line, std::string_view kind) {
  const auto known = std::ranges::find(kinds_, kind, &Kind::text);
  if (known == kinds_.end()) {
    kinds_.push_back({std::string(kind), line, line, 1});
  } else if (known->last_line != line) {
    known->last_line = line;
    ++known->count;
  }
}

void LineWarnings::append_to(std::vector<std::string>& warnings) const {
  for (const Kind& kind : kinds_) {
    const std::string more = kind.count > 1 ? fmt::format(" ({} such lines)", kind.count) : "";
    warnings.push_back(fmt::format("{}: line {}: {}{}", file_, kind.first_line, kind.text, more));
  }
}

bool is_one_of(std::string_view key, std::span<const std::string_view> keys) {
  return std::ranges::find(keys, key) != keys.end();
}

Result<Model> read_obj(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                       const ModelLimits& limits, double& file_step) {
  ObjReader reader(file, limits);
  Result<Model> model = reader.read({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  file_step = reader.file_step();
  return model;
}

}  // namespace penumbra
