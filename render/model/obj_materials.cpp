// Reads .mtl files.
#include <algorithm>
#include <array>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/obj_reader.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxMaterials = 10'000;
constexpr float kPlainGrey = 0.6F;  // linear light
constexpr double kMaxColor = 1e6;

Material plain_material(const std::string& name) {
  Material plain;
  plain.name = name;
  plain.base_color = glm::vec4(kPlainGrey, kPlainGrey, kPlainGrey, 1.0F);
  plain.double_sided = true;  // OBJ does not define the front of a face
  return plain;
}

// Returns linear light. The format does not define the encoding; modelling programs write sRGB.
float light_of(double value) {
  return linear_from_srgb(static_cast<float>(std::clamp(value, 0.0, 1.0)));
}

// Returns a number in [0, kMaxColor], or nullopt.
std::optional<double> factor_from(std::string_view word) {
  const std::optional<double> value = finite_number(word);
  if (!value || *value < 0.0 || *value > kMaxColor) return std::nullopt;
  return value;
}

// Reads r [g b]; absent components equal red. Returns nullopt for other forms.
std::optional<glm::vec3> color_from(const std::vector<std::string_view>& words) {
  if (words.size() < 2) return std::nullopt;
  glm::vec3 color(0.0F);
  for (std::size_t i = 0; i < 3; ++i) {
    const std::optional<double> value = factor_from(words[i + 1 < words.size() ? i + 1 : 1]);
    if (!value) return std::nullopt;
    color[static_cast<int>(i)] = light_of(*value);
  }
  return color;
}

// Removes quotes around a file name, and the backslash of "\ ".
std::string unescaped(std::string_view name) {
  if (name.size() >= 2 && name.front() == '"' && name.back() == '"') {
    name = name.substr(1, name.size() - 2);
  }
  std::string plain;
  for (std::size_t i = 0; i < name.size(); ++i) {
    if (name[i] == '\\' && i + 1 < name.size() && name[i + 1] == ' ') continue;
    plain += name[i];
  }
  return plain;
}

// Splits names at blanks that no backslash precedes.
std::vector<std::string> split_names(std::string_view text) {
  std::vector<std::string> names(1);
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool blank = text[i] == ' ' || text[i] == '\t';
    if (blank && !(i > 0 && text[i - 1] == '\\')) {
      if (!names.back().empty()) names.emplace_back();
    } else {
      names.back() += text[i];
    }
  }
  if (names.back().empty()) names.pop_back();
  for (std::string& name : names) name = unescaped(name);
  return names;
}

// Returns the text before a word that starts with '#'.
std::string_view without_comment(std::string_view text) {
  for (const std::string_view start : {" #", "\t#"}) {
    if (const std::size_t at = text.find(start); at != std::string_view::npos) {
      text = text.substr(0, text.find_last_not_of(" \t", at) + 1);
    }
  }
  return text;
}

bool is_beside(const std::filesystem::path& folder, const std::string& name) {
  const auto path = model_resource_path(folder, name);
  std::error_code ignored;
  return path && std::filesystem::is_regular_file(*path, ignored);
}

// Returns the maximum number of arguments of an image option; nullopt for other words.
std::optional<std::size_t> option_arguments(std::string_view word) {
  if (word == "-o" || word == "-s" || word == "-t") return 3;
  if (word == "-mm") return 2;
  static constexpr std::array<std::string_view, 9> kOneArgument = {
      "-blendu", "-blendv", "-cc", "-clamp", "-texres", "-boost", "-bm", "-imfchan", "-type"};
  return is_one_of(word, kOneArgument) ? std::optional<std::size_t>(1) : std::nullopt;
}

struct ImageLine {
  std::string_view name;
  bool clamps = false;
  std::string_view ignored;  // an unsupported option that affects the image
};

// Reads "[options] name with blanks".
ImageLine image_from(std::string_view line) {
  ImageLine image{after_keyword(line), false, {}};
  while (true) {
    const std::vector<std::string_view> words = obj_words(image.name);
    const auto limit = words.empty() ? std::nullopt : option_arguments(words[0]);
    if (!limit || words.size() < 2) return image;
    const bool numbers = *limit > 1;
    std::size_t used = numbers ? 0 : 1;
    while (numbers && used < *limit && used + 2 < words.size() && finite_number(words[used + 1])) {
      ++used;
    }
    if (words[0] == "-clamp") image.clamps = words[1] == "on";
    const double neutral = words[0] == "-s" ? 1.0 : 0.0;
    for (std::size_t i = 1; numbers && words[0] != "-mm" && i <= used; ++i) {
      if (finite_number(words[i]) != neutral) image.ignored = words[0];
    }
    const std::string_view last = words[used];
    image.name.remove_prefix(
        static_cast<std::size_t>(last.data() + last.size() - image.name.data()));
    image.name.remove_prefix(std::min(image.name.find_first_not_of(" \t"), image.name.size()));
  }
}

// Keys for highlights and refraction, which are not drawn.
constexpr std::array<std::string_view, 8> kMtlWithoutEffect = {
    "Ka", "Ks", "Ns", "Ni", "illum", "sharpness", "Tf", "map_aat"};
// Unsupported keys of the format and of its extension for physically based materials.
constexpr std::array<std::string_view, 23> kMtlIgnored = {
    "map_Ka", "map_Ks",  "map_Ke",  "map_Ns",   "map_Ni",   "map_Tr", "map_Pr", "map_Pm",
    "map_Ps", "map_RMA", "map_ORM", "map_bump", "map_Bump", "bump",   "norm",   "disp",
    "decal",  "refl",    "Ps",      "Pc",       "Pcr",      "aniso",  "anisor"};

void read_material_line(ObjMaterial& current, std::string_view line, std::size_t number,
                        LineWarnings& warnings) {
  const std::vector<std::string_view> words = obj_words(line);
  const std::string_view key = words[0];
  Material& material = current.material;
  if (key == "Kd" || key == "Ke") {
    const std::optional<glm::vec3> color = color_from(words);
    if (!color) {
      warnings.add(number, fmt::format("{} is not a colour (numbers of at least 0{}); {}", key,
                                       words.size() > 1 && has_decimal_comma(words[1])
                                           ? ", with decimal points in place of decimal commas"
                                           : "",
                                       key == "Kd" ? "plain grey is used" : "it is ignored"));
    } else if (key == "Kd") {
      material.base_color = glm::vec4(*color, material.base_color.a);
    } else {
      material.emissive = *color;
    }
    if (color && words.size() > 4) {
      warnings.add(number, fmt::format("{} has over three numbers; the first three are used", key));
    }
  } else if (key == "d" || key == "Tr" || key == "Pr" || key == "Pm") {
    const bool halo = words.size() > 2 && words[1] == "-halo";
    const std::optional<double> value =
        words.size() > 1 ? factor_from(words[halo ? 2 : 1]) : std::nullopt;
    if (!value) {
      warnings.add(number, fmt::format("{} is not a number of at least 0; it is ignored", key));
      return;
    }
    const auto factor = static_cast<float>(std::min(*value, 1.0));
    if (halo) warnings.add(number, "-halo is drawn as an opacity that is the same all over");
    if (key == "d" || (key == "Tr" && !current.has_dissolve)) {
      material.base_color.a = key == "d" ? factor : 1.0F - factor;
      current.has_dissolve = current.has_dissolve || key == "d";
    } else if (key == "Pr" && factor > 0.0F) {
      material.roughness = factor;
    } else if (key == "Pm") {
      material.metallic = factor;
    }
  } else if (key == "map_Kd") {
    const ImageLine image = image_from(line);
    current.image = std::string(image.name);
    current.clamps = image.clamps;
    if (!image.ignored.empty()) {
      warnings.add(number, fmt::format("the option {} of map_Kd is ignored", image.ignored));
    }
  } else if (key == "map_d") {
    warnings.add(number, "map_d is ignored; its material is drawn without cut-outs");
  } else if (is_one_of(key, kMtlIgnored)) {
    warnings.add(number, fmt::format("{} is ignored", key));
  } else if (!is_one_of(key, kMtlWithoutEffect)) {
    warnings.add(number, "a line does not start with a word of the MTL format and is skipped");
  }
}

}  // namespace

std::optional<std::size_t> ObjMaterials::find(const std::string& name) const {
  const auto known = by_name_.find(name);
  if (known == by_name_.end()) return std::nullopt;
  return known->second;
}

void ObjMaterials::read_files(std::string_view names, std::size_t line) {
  if (names.empty()) return;
  // A name may contain blanks, and a comment may follow.
  for (const std::string_view whole : {names, without_comment(names)}) {
    if (is_beside(folder_, unescaped(whole))) return read_file_named(unescaped(whole), line);
  }
  const std::vector<std::string> parts = split_names(without_comment(names));
  const bool any =
      std::ranges::any_of(parts, [&](const std::string& part) { return is_beside(folder_, part); });
  if (!any) return read_file_named(unescaped(without_comment(names)), line);
  for (const std::string& part : parts) read_file_named(part, line);
}

void ObjMaterials::read_file_named(const std::string& name, std::size_t line) {
  const auto ignore = [&](const std::string& cause) {
    incomplete_ = true;
    warnings_.push_back(fmt::format("{}: line {}: {}; its materials are drawn in plain grey",
                                    model_name_, line, cause));
  };
  const Result<std::filesystem::path> file = model_resource_path(folder_, name);
  const std::string path = file ? file->lexically_normal().string() : name;
  if (!files_.insert(path).second) return;
  if (!file) return ignore(file.error().message);
  std::error_code ignored;
  if (!std::filesystem::exists(*file, ignored)) {
    return ignore(fmt::format("there is no {}", file->string()));
  }
  const Result<std::vector<std::uint8_t>> bytes = read_file(*file, limits_.max_file_bytes);
  if (!bytes) return ignore(bytes.error().message);
  read_files_.push_back(*file);
  const Result<std::string_view> text = without_byte_order_mark(
      {reinterpret_cast<const char*>(bytes->data()), bytes->size()}, file->string());
  if (!text) return ignore(text.error().message);
  if (text->find('\0') != std::string_view::npos) return ignore(file->string() + ": is not text");
  if (leaves_folder(name)) {
    warnings_.push_back(fmt::format("{}: line {}: \"{}\" is outside the model's folder; {} is used",
                                    model_name_, line, as_utf8(shortened(name, 200)),
                                    file->string()));
  }
  read_text(*text, file->string());
}

void ObjMaterials::read_text(std::string_view text, const std::string& file) {
  LineWarnings warnings(file);
  const std::size_t before = materials_.size();
  std::size_t number = 0;
  for (std::size_t at = 0; at < text.size();) {
    std::string_view line = text.substr(at, std::min(text.find('\n', at), text.size()) - at);
    at += line.size() + 1;
    ++number;
    const std::vector<std::string_view> words = obj_words(line);
    if (words.empty()) continue;
    line.remove_prefix(static_cast<std::size_t>(words[0].data() - line.data()));
    if (line.ends_with('\r')) line.remove_suffix(1);
    if (words[0] == "newmtl") {
      if (materials_.size() >= kMaxMaterials) {
        warnings.add(number, fmt::format("only the first {} materials are read", kMaxMaterials));
        break;
      }
      const Material plain = plain_material(as_utf8(after_keyword(line)));
      by_name_.try_emplace(plain.name, materials_.size());
      materials_.push_back({plain, "", false, false});
    } else if (materials_.size() > before) {
      read_material_line(materials_.back(), line, number, warnings);
    } else {
      warnings.add(number, "a line before the first newmtl is skipped");
    }
  }
  warnings.append_to(warnings_);
}

void ObjMaterials::load_image(Model& model, ObjMaterial& from) {
  const std::string_view whole = from.image;
  const bool comment = !is_beside(folder_, unescaped(whole));
  const std::string name = unescaped(comment ? without_comment(whole) : whole);
  int& image = from.material.base_color_texture.image;
  const auto [known, is_new] = images_.try_emplace(name, -1);
  if (!is_new) {
    image = known->second;
    return;
  }
  const auto load = [&]() -> Result<int> {
    PENUMBRA_TRY(const std::filesystem::path file, model_resource_path(folder_, name));
    PENUMBRA_TRY(std::vector<std::uint8_t> bytes, read_file(file, limits_.max_file_bytes));
    read_files_.push_back(file);
    PENUMBRA_TRY(RgbaImage decoded, decode_rgba(bytes, file.string()));
    Result<int> added =
        add_texture(model, std::move(decoded), file.string(), limits_, std::move(bytes));
    if (added && leaves_folder(name)) {
      warnings_.push_back(fmt::format(
          "{}: material \"{}\": \"{}\" is outside the model's folder; {} is used", model_name_,
          from.material.name, as_utf8(shortened(name, 200)), file.string()));
    }
    return added;
  };
  const Result<int> loaded = load();
  if (!loaded) {
    warnings_.push_back(fmt::format("{}: material \"{}\": {}; it is drawn in plain colour",
                                    model_name_, from.material.name, loaded.error().message));
  }
  image = known->second = loaded.value_or(-1);
}

void ObjMaterials::move_to(Model& model, const std::vector<bool>& used) {
  for (std::size_t i = 0; i < materials_.size(); ++i) {
    ObjMaterial& from = materials_[i];
    Material& material = from.material;
    if (!from.image.empty() && used[i]) load_image(model, from);
    if (material.base_color_texture.image >= 0) {
      // The image replaces Kd, because many exporters write a dark Kd next to it.
      material.base_color = glm::vec4(1.0F, 1.0F, 1.0F, material.base_color.a);
      TextureSampling& sampling = material.base_color_texture.sampling;
      if (from.clamps) sampling.wrap_s = sampling.wrap_t = TextureWrap::clamp;
    }
    if (material.base_color.a < 1.0F) material.alpha_mode = AlphaMode::blend;
    model.materials.push_back(std::move(material));
  }
  model.materials.push_back(plain_material("default"));
  model.warnings.insert(model.warnings.end(), warnings_.begin(), warnings_.end());
  model.files = read_files_;
}

}  // namespace penumbra
