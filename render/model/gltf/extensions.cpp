#include "render/model/gltf/extensions.hpp"

#include <algorithm>
#include <array>
#include <string_view>

namespace penumbra::gltf {
namespace {

enum class Effect {
  read,
  none,
  light,
  material,
  variants,
  levels,
  animation,
  outlines,
  texture,
  compression,
  unknown
};

// The first entry that an extension's name starts with.
struct Known {
  std::string_view start;
  Effect effect;
};
constexpr std::array kKnown{
    Known{"KHR_mesh_quantization", Effect::read},
    Known{kInstancing, Effect::read},
    Known{kVisibility, Effect::read},
    Known{kDraco, Effect::compression},
    Known{"EXT_meshopt_compression", Effect::compression},
    Known{"KHR_meshopt_compression", Effect::compression},
    Known{"KHR_lights_", Effect::light},
    Known{"EXT_lights_", Effect::light},
    Known{"KHR_materials_variants", Effect::variants},
    Known{"KHR_materials_", Effect::material},
    Known{"EXT_materials_", Effect::material},
    Known{"ADOBE_materials_", Effect::material},
    Known{"NV_materials_", Effect::material},
    Known{"MSFT_packing_", Effect::material},
    Known{"KHR_technique", Effect::material},  // _webgl, and techniques_webgl
    Known{"KHR_texture_", Effect::texture},
    Known{"EXT_texture_", Effect::texture},
    Known{"MSFT_texture_dds", Effect::texture},
    Known{"GOOGLE_texture_basis", Effect::texture},
    // Data about the model, other levels of detail, sound and behaviour.
    Known{"KHR_xmp", Effect::none},
    Known{"KHR_animation_pointer", Effect::animation},
    Known{"KHR_audio", Effect::none},
    Known{"KHR_interactivity", Effect::none},
    Known{"KHR_node_hoverability", Effect::none},
    Known{"KHR_node_selectability", Effect::none},
    Known{"KHR_physics_", Effect::none},
    Known{"KHR_implicit_shapes", Effect::none},
    Known{"EXT_mesh_features", Effect::none},
    Known{"EXT_instance_features", Effect::none},
    Known{"EXT_structural_metadata", Effect::none},
    Known{"EXT_feature_metadata", Effect::none},
    Known{"EXT_mesh_manifold", Effect::none},
    Known{"EXT_property_animation", Effect::animation},
    Known{"CESIUM_primitive_outline", Effect::outlines},
    Known{"MSFT_lod", Effect::levels},
    Known{"AGI_", Effect::none},
    Known{"OMI_", Effect::none},
};

Effect effect_of(std::string_view extension) {
  const auto known = std::ranges::find_if(
      kKnown, [&](const Known& entry) { return extension.starts_with(entry.start); });
  return known == kKnown.end() ? Effect::unknown : known->effect;
}

bool is_required(const Document& document, const std::string& extension) {
  return std::ranges::count(document.model.extensionsRequired, extension) > 0;
}

std::string consequence(Effect effect) {
  switch (effect) {
    case Effect::light:
      return "its lights are not used";
    case Effect::material:
      return "materials are drawn by their base properties";
    case Effect::variants:
      return "the default materials are shown";
    case Effect::levels:
      return "the finest level of detail is shown";
    case Effect::animation:
      return "the rest pose is shown";
    case Effect::outlines:
      return "outlines are not drawn";
    case Effect::texture:
      return "textures are drawn without it";
    default:
      return "the shape does not depend on it";
  }
}

}  // namespace

const char* compression_of(const tinygltf::BufferView& view) {
  for (const char* extension : {"EXT_meshopt_compression", "KHR_meshopt_compression"}) {
    if (view.extensions.contains(extension)) return extension;
  }
  return nullptr;
}

tl::unexpected<Error> fail_compressed(const std::string& name, const std::string& extension) {
  return fail(
      "{}: needs the glTF extension {}, which can't be read yet; export without compression", name,
      extension);
}

Result<void> check_required(const std::string& name, const Document& document) {
  for (const std::string& extension : document.model.extensionsRequired) {
    const Effect effect = effect_of(extension);
    if (effect == Effect::compression) return fail_compressed(name, extension.substr(0, 80));
    if (effect == Effect::unknown) {
      return fail("{}: needs the glTF extension {}, which can't be read; export without it", name,
                  extension.substr(0, 80));
    }
  }
  return {};
}

std::vector<std::string> ignored_content(const std::string& name, const Document& document) {
  std::vector<std::string> lines;
  if (!document.erased_fields.empty()) {
    const std::size_t more = document.erased_fields.size() - 1;
    lines.push_back(on_one_line(
        fmt::format("{}: {}{}; the default is taken", name, document.erased_fields.front(),
                    more > 0 ? fmt::format(" (and {} more such fields)", more) : "")));
  }
  if (document.animation_count > 0) {
    lines.push_back(fmt::format("{}: its animations ({}) are not played: the rest pose is shown",
                                name, document.animation_count));
  }
  if (document.camera_count > 0) {
    lines.push_back(fmt::format("{}: its cameras ({}) are not used", name, document.camera_count));
  }
  if (const auto& scenes = document.model.scenes; scenes.size() > 1) {
    const auto shown = static_cast<std::size_t>(std::max(document.model.defaultScene, 0));
    const std::string scene = shown < scenes.size() ? scenes[shown].name.substr(0, 60) : "";
    lines.push_back(
        on_one_line(fmt::format("{}: has {} scenes; only scenes/{}{} is shown", name, scenes.size(),
                                shown, scene.empty() ? "" : fmt::format(" (\"{}\")", scene))));
  }
  for (const std::string& extension : document.model.extensionsRequired) {
    const Effect effect = effect_of(extension);
    if (effect == Effect::read) continue;
    lines.push_back(fmt::format("{}: needs the glTF extension {}, which is not read: {}", name,
                                extension.substr(0, 80), consequence(effect)));
  }
  for (const auto& [extension, use] : document.extensions) {
    const Effect effect = effect_of(extension);
    // Warnings about textures come from the material reader.
    const bool quiet = effect == Effect::read || effect == Effect::none ||
                       effect == Effect::texture || effect == Effect::compression;
    if (quiet || is_required(document, extension)) continue;
    lines.push_back(fmt::format("{}: its glTF extension {} ({}) is not read{}", name,
                                extension.substr(0, 80), use.first_place,
                                effect == Effect::unknown ? "" : ": " + consequence(effect)));
  }
  return lines;
}

}  // namespace penumbra::gltf
