#include "render/model/gltf/materials.hpp"

#include <algorithm>
#include <array>

#include "core/propagate.hpp"
#include "render/model/gltf/compression/webp.hpp"
#include "render/model/gltf/extensions.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra::gltf {

namespace {

struct WrapMode {
  int code;
  TextureWrap wrap;
};
constexpr std::array kWrapModes{
    WrapMode{TINYGLTF_TEXTURE_WRAP_REPEAT, TextureWrap::repeat},
    WrapMode{TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT, TextureWrap::mirrored},
    WrapMode{TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE, TextureWrap::clamp},
};

struct MinFilter {
  int code;
  bool smooth;
  TextureMipmaps mipmaps;
};
constexpr std::array kMinFilters{
    MinFilter{TINYGLTF_TEXTURE_FILTER_NEAREST, false, TextureMipmaps::none},
    MinFilter{TINYGLTF_TEXTURE_FILTER_LINEAR, true, TextureMipmaps::none},
    MinFilter{TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_NEAREST, false, TextureMipmaps::nearest},
    MinFilter{TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_NEAREST, true, TextureMipmaps::nearest},
    MinFilter{TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_LINEAR, false, TextureMipmaps::linear},
    MinFilter{TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_LINEAR, true, TextureMipmaps::linear},
};

// Returns the image of EXT_texture_webp, or -1.
int webp_source(const tinygltf::Texture& texture) {
  const auto extension = texture.extensions.find(kWebp);
  if (extension == texture.extensions.end() || !extension->second.Has("source")) return -1;
  return extension->second.Get("source").GetNumberAsInt();
}

}  // namespace

Result<TextureSampling> MaterialReader::sampling(int index) const {
  TextureSampling result;
  if (index < 0) return result;
  if (!has(gltf_.samplers, index)) {
    return fail("a texture names sampler {}, there are {}", index, gltf_.samplers.size());
  }
  const tinygltf::Sampler& from = gltf_.samplers[static_cast<std::size_t>(index)];
  const auto unknown = [&](const char* field, int value) {
    return fail("samplers/{}/{}: {} is none of glTF's values", index, field, value);
  };
  const auto s = std::ranges::find(kWrapModes, from.wrapS, &WrapMode::code);
  const auto t = std::ranges::find(kWrapModes, from.wrapT, &WrapMode::code);
  if (s == kWrapModes.end()) return unknown("wrapS", from.wrapS);
  if (t == kWrapModes.end()) return unknown("wrapT", from.wrapT);
  result.wrap_s = s->wrap;
  result.wrap_t = t->wrap;
  if (from.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST) {
    result.smooth_near = false;
  } else if (from.magFilter >= 0 && from.magFilter != TINYGLTF_TEXTURE_FILTER_LINEAR) {
    return unknown("magFilter", from.magFilter);
  }
  if (from.minFilter < 0) return result;
  const auto filter = std::ranges::find(kMinFilters, from.minFilter, &MinFilter::code);
  if (filter == kMinFilters.end()) return unknown("minFilter", from.minFilter);
  result.smooth_far = filter->smooth;
  result.mipmaps = filter->mipmaps;
  return result;
}

template <class Info>
Result<MaterialTexture> MaterialReader::texture(const Info& info, const std::string& what,
                                                std::vector<TextureLayout>& layouts) {
  MaterialTexture result;
  if (info.index < 0) return result;
  if (!has(gltf_.textures, info.index)) {
    return fail("{}: names texture {}, there are {}", what, info.index, gltf_.textures.size());
  }
  PENUMBRA_TRY(const TextureSampling sampled,
               sampling(gltf_.textures[static_cast<std::size_t>(info.index)].sampler));
  const int image = image_of(info.index);
  if (image < 0) return result;
  const TextureLayout layout = texture_layout(info.texCoord, info.extensions, what, notes_);
  auto known = std::ranges::find(layouts, layout);
  if (known == layouts.end()) {
    if (layouts.size() == 2) {
      notes_.add(
          "is ignored: it is the third of its material's textures that are laid out in different "
          "ways",
          what);
      return result;
    }
    layouts.push_back(layout);
    known = layouts.end() - 1;
  }
  result.image = image;
  result.texcoords = static_cast<int>(known - layouts.begin());
  result.sampling = sampled;
  return result;
}

int MaterialReader::image_of(int index) {
  const tinygltf::Texture& texture = gltf_.textures[static_cast<std::size_t>(index)];
  const std::string json_path = fmt::format("textures/{}", index);
  const bool has_source = texture.source >= 0;
  if (const int webp = webp_source(texture); webp >= 0) {
    // The source is a fallback; it also replaces a WebP image that can't be read.
    const int image = decode_once(webp, has_source);
    if (image >= 0 || !has_source) return image;
  }
  if (!has_source) {
    if (texture.extensions.empty()) {
      notes_.add("has no source; drawn in plain colour", json_path);
    } else {
      notes_.add(fmt::format("has only an image of the glTF extension {}, which can't be read; "
                             "drawn in plain colour",
                             texture.extensions.begin()->first.substr(0, 80)),
                 json_path);
    }
    return -1;
  }
  return decode_once(texture.source, false);
}

int MaterialReader::decode_once(int image, bool quiet) {
  const auto [known, is_new] = texture_of_image_.try_emplace(image, -1);
  if (!is_new) return known->second;
  const Result<int> decoded = decoded_image(image);
  if (decoded) return known->second = *decoded;
  if (quiet) {
    texture_of_image_.erase(known);  // another use without a fallback must warn
  } else {
    model_.warnings.push_back(decoded.error().message + "; drawn in plain colour");
  }
  return -1;
}

Result<int> MaterialReader::decoded_image(int index) {
  if (!has(document_.images, index)) {
    return fail("a texture names image {}, there are {}", index, document_.images.size());
  }
  const ImageSource& image = document_.images[static_cast<std::size_t>(index)];
  const std::string json_path = fmt::format("images/{}", index);
  if (image.buffer_view >= 0) {
    PENUMBRA_TRY(const std::span<const std::uint8_t> coded,
                 accessors_.view_bytes(image.buffer_view, json_path));
    return add_image(coded, json_path);
  }
  if (image.uri.empty()) return fail("{}: has neither a uri nor a bufferView", json_path);
  const Result<std::vector<std::uint8_t>> coded = buffers_.fetch(image.uri);
  if (!coded) return fail_in(json_path, coded.error());
  return add_image(*coded, json_path);
}

Result<int> MaterialReader::add_image(std::span<const std::uint8_t> coded,
                                      const std::string& name) {
  PENUMBRA_TRY(RgbaImage image,
               is_webp(coded) ? decode_webp(coded, name) : decode_rgba(coded, name));
  return add_texture(model_, std::move(image), name, limits_);
}

float MaterialReader::emissive_strength(const tinygltf::Material& from,
                                        const std::string& what) const {
  const auto extension = from.extensions.find(kEmissiveStrength);
  if (extension == from.extensions.end() || !extension->second.Has("emissiveStrength")) return 1.0F;
  const double strength = extension->second.Get("emissiveStrength").GetNumberAsDouble();
  constexpr auto kLargest = static_cast<double>(kMaxEmissive);
  if (!(strength >= 0.0 && strength <= kLargest)) {
    notes_.add(fmt::format("its emissiveStrength is outside 0 to {:g} and is clamped", kLargest),
               what);
  }
  return static_cast<float>(strength >= 0.0 ? std::min(strength, kLargest) : 0.0);
}

Result<Material> MaterialReader::factors(std::size_t index) const {
  const tinygltf::Material& from = gltf_.materials[index];
  const tinygltf::PbrMetallicRoughness& pbr = from.pbrMetallicRoughness;
  const std::string what = fmt::format("materials/{}", index);
  if (pbr.baseColorFactor.size() != 4 ||
      (!from.emissiveFactor.empty() && from.emissiveFactor.size() != 3)) {
    return fail("{}: a colour has the wrong number of components", what);
  }
  // The tolerance accepts factors that an exporter rounded above 1.
  constexpr double kRounding = 1e-3;
  const auto in_unit = [&](double factor) {
    if (factor < -kRounding || factor > 1.0 + kRounding) {
      notes_.add("a factor is outside 0 to 1 and is clamped", what);
    }
    return static_cast<float>(std::clamp(factor, 0.0, 1.0));
  };
  Material material;
  material.name = from.name.empty() ? what : from.name;
  for (int c = 0; c < 4; ++c) {
    material.base_color[c] = in_unit(pbr.baseColorFactor[static_cast<std::size_t>(c)]);
  }
  if (from.alphaMode == "MASK") {
    material.alpha_mode = AlphaMode::mask;
    material.alpha_cutoff = static_cast<float>(from.alphaCutoff);
  } else if (from.alphaMode == "BLEND") {
    material.alpha_mode = AlphaMode::blend;
  } else if (from.alphaMode == "OPAQUE") {
    material.base_color.a = 1.0F;
  } else {
    return fail("{}/alphaMode: \"{}\" is none of OPAQUE, MASK and BLEND", what,
                from.alphaMode.substr(0, 40));
  }
  for (int c = 0; c < 3 && !from.emissiveFactor.empty(); ++c) {
    material.emissive[c] = in_unit(from.emissiveFactor[static_cast<std::size_t>(c)]);
  }
  material.emissive *= emissive_strength(from, what);
  material.unlit = from.extensions.contains(kUnlit);
  material.metallic = in_unit(pbr.metallicFactor);
  material.roughness = in_unit(pbr.roughnessFactor);
  material.double_sided = from.doubleSided;
  material.normal_scale = static_cast<float>(from.normalTexture.scale);
  const double occlusion = from.occlusionTexture.strength;
  material.occlusion_strength =
      static_cast<float>(occlusion > 1.0 && occlusion <= 1.0 + kRounding ? 1.0 : occlusion);
  return material;
}

Result<void> MaterialReader::read_textures(std::size_t index, Material& to) {
  const tinygltf::Material& from = gltf_.materials[index];
  const tinygltf::PbrMetallicRoughness& pbr = from.pbrMetallicRoughness;
  std::vector<TextureLayout>& layouts = layouts_[index];
  const auto read = [&](const auto& info, const char* which) {
    return texture(info, fmt::format("materials/{}/{}", index, which), layouts);
  };
  PENUMBRA_TRY(to.base_color_texture, read(pbr.baseColorTexture, "baseColorTexture"));
  PENUMBRA_TRY(to.metallic_roughness_texture,
               read(pbr.metallicRoughnessTexture, "metallicRoughnessTexture"));
  PENUMBRA_TRY(to.normal_texture, read(from.normalTexture, "normalTexture"));
  PENUMBRA_TRY(to.occlusion_texture, read(from.occlusionTexture, "occlusionTexture"));
  PENUMBRA_TRY(to.emissive_texture, read(from.emissiveTexture, "emissiveTexture"));
  return {};
}

Result<void> MaterialReader::read(const std::vector<bool>& used) {
  layouts_.resize(gltf_.materials.size() + 1);
  for (std::size_t i = 0; i < gltf_.materials.size(); ++i) {
    Material material;
    material.name = gltf_.materials[i].name;
    if (used[i]) {
      PENUMBRA_TRY(material, factors(i));
      PENUMBRA_TRY_VOID(read_textures(i, material));
    }
    model_.materials.push_back(std::move(material));
  }
  // The default material is plain white. The specification's default material (5.19) is a metal,
  // which is black without an environment map.
  model_.materials.emplace_back().name = "default";
  return {};
}

}  // namespace penumbra::gltf
