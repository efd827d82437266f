#include "render/model/gltf/extensions.hpp"

#include <algorithm>
#include <array>
#include <string_view>

#include "core/text/text.hpp"

namespace penumbra::gltf {
namespace {

// `none`: has no effect on the image. `ignored` causes a warning. `texture`: materials.cpp warns.
enum class Effect { read, none, ignored, texture, unknown };

// For an extension, the first entry applies whose `start` is a prefix of its name.
struct KnownExtension {
  std::string_view start;
  Effect effect;
  std::string_view consequence = "the shape does not depend on it";
};
constexpr std::string_view kBaseMaterials = "materials are drawn by their base properties";
constexpr std::string_view kPlainTextures = "textures are drawn without it";
constexpr std::string_view kNoLights = "its lights are not used";
constexpr std::string_view kNotAnimated = "what only it animates keeps its value";
constexpr std::array kKnown{
    KnownExtension{"KHR_mesh_quantization", Effect::read},
    KnownExtension{kInstancing, Effect::read},
    KnownExtension{kVisibility, Effect::read},
    KnownExtension{kDraco, Effect::read},
    KnownExtension{kMeshoptNames[0], Effect::read},
    KnownExtension{kMeshoptNames[1], Effect::read},
    KnownExtension{"KHR_lights_", Effect::ignored, kNoLights},
    KnownExtension{"EXT_lights_", Effect::ignored, kNoLights},
    KnownExtension{"KHR_materials_variants", Effect::ignored, "the default materials are shown"},
    KnownExtension{kUnlit, Effect::read},
    KnownExtension{kEmissiveStrength, Effect::read},
    KnownExtension{"KHR_materials_", Effect::ignored, kBaseMaterials},
    KnownExtension{"EXT_materials_", Effect::ignored, kBaseMaterials},
    KnownExtension{"ADOBE_materials_", Effect::ignored, kBaseMaterials},
    KnownExtension{"NV_materials_", Effect::ignored, kBaseMaterials},
    KnownExtension{"MSFT_packing_", Effect::ignored, kBaseMaterials},
    KnownExtension{"KHR_technique", Effect::ignored, kBaseMaterials},  // KHR_technique(s)_webgl
    KnownExtension{kTextureTransform, Effect::read},
    KnownExtension{kWebp, Effect::read},
    KnownExtension{"KHR_texture_", Effect::texture, kPlainTextures},
    KnownExtension{"EXT_texture_", Effect::texture, kPlainTextures},
    KnownExtension{"MSFT_texture_dds", Effect::texture, kPlainTextures},
    KnownExtension{"GOOGLE_texture_basis", Effect::texture, kPlainTextures},
    // Metadata, levels of detail, audio and behaviour.
    KnownExtension{"KHR_xmp", Effect::none},
    KnownExtension{"KHR_animation_pointer", Effect::ignored, kNotAnimated},
    KnownExtension{"KHR_audio", Effect::none},
    KnownExtension{"KHR_interactivity", Effect::none},
    KnownExtension{"KHR_node_hoverability", Effect::none},
    KnownExtension{"KHR_node_selectability", Effect::none},
    KnownExtension{"KHR_physics_", Effect::none},
    KnownExtension{"KHR_implicit_shapes", Effect::none},
    KnownExtension{"EXT_mesh_features", Effect::none},
    KnownExtension{"EXT_instance_features", Effect::none},
    KnownExtension{"EXT_structural_metadata", Effect::none},
    KnownExtension{"EXT_feature_metadata", Effect::none},
    KnownExtension{"EXT_mesh_manifold", Effect::none},
    KnownExtension{"EXT_property_animation", Effect::ignored, kNotAnimated},
    KnownExtension{"CESIUM_primitive_outline", Effect::ignored, "outlines are not drawn"},
    KnownExtension{"MSFT_lod", Effect::ignored, "the finest level of detail is shown"},
    KnownExtension{"AGI_", Effect::none},
    KnownExtension{"OMI_", Effect::none},
};

const KnownExtension& known_extension(std::string_view extension) {
  static constexpr KnownExtension kUnknown{"", Effect::unknown};
  const auto entry = std::ranges::find_if(kKnown, [&](const KnownExtension& candidate) {
    return extension.starts_with(candidate.start);
  });
  return entry == kKnown.end() ? kUnknown : *entry;
}

}  // namespace

const char* compression_of(const tinygltf::BufferView& view) {
  for (const char* extension : kMeshoptNames) {
    if (view.extensions.contains(extension)) return extension;
  }
  return nullptr;
}

Result<void> check_required(const Document& document) {
  for (const std::string& extension : document.model.extensionsRequired) {
    const Effect effect = known_extension(extension).effect;
    if (effect == Effect::unknown) {
      return fail("needs the glTF extension {}, which can't be read; export without it",
                  shortened(extension, 80));
    }
  }
  return {};
}

std::vector<std::string> ignored_content(const Document& document, bool posed) {
  std::vector<std::string> lines;
  if (!document.erased_fields.empty()) {
    const std::size_t more = document.erased_fields.size() - 1;
    lines.push_back(fmt::format("{}{}; the default is taken", document.erased_fields.front(),
                                more > 0 ? fmt::format(" (and {} more such fields)", more) : ""));
  }
  if (!document.animations.empty() && !posed) {
    lines.push_back(fmt::format("its animations ({}) are not played: the rest pose is shown",
                                document.animations.size()));
  }
  if (document.camera_count > 0) {
    lines.push_back(fmt::format("its cameras ({}) are not used", document.camera_count));
  }
  if (const auto& scenes = document.model.scenes; scenes.size() > 1) {
    const auto shown = static_cast<std::size_t>(std::max(document.model.defaultScene, 0));
    const std::string scene = shown < scenes.size() ? shortened(scenes[shown].name, 60) : "";
    lines.push_back(fmt::format("has {} scenes; only scenes/{}{} is shown", scenes.size(), shown,
                                scene.empty() ? "" : fmt::format(" (\"{}\")", scene)));
  }
  for (const std::string& extension : document.model.extensionsRequired) {
    if (known_extension(extension).effect == Effect::read) continue;
    lines.push_back(fmt::format("needs the glTF extension {}, which is not read: {}",
                                shortened(extension, 80), known_extension(extension).consequence));
  }
  for (const auto& [extension, first_json_path] : document.extensions) {
    const auto& [start, effect, consequence] = known_extension(extension);
    if (effect != Effect::ignored && effect != Effect::unknown) continue;
    if (std::ranges::count(document.model.extensionsRequired, extension) > 0) continue;
    lines.push_back(fmt::format(
        "its glTF extension {} ({}) is not read{}{}", shortened(extension, 80), first_json_path,
        effect == Effect::unknown ? "" : ": ", effect == Effect::unknown ? "" : consequence));
  }
  return lines;
}

}  // namespace penumbra::gltf
