// Materials with their textures and samplers.
#include <algorithm>
#include <optional>

#include "render/gltf/gltf_reader.hpp"
#include "render/model_parts.hpp"

namespace penumbra {

Result<TextureSampling> GltfReader::sampling(int index) const {
  TextureSampling result;
  if (index < 0) return result;
  if (!has(gltf_.samplers, index)) {
    return fail("{}: a texture names sampler {}, there are {}", name_, index,
                gltf_.samplers.size());
  }
  const tinygltf::Sampler& from = gltf_.samplers[static_cast<std::size_t>(index)];
  const auto unknown = [&](const char* field, int value) {
    return fail("{}: samplers/{}/{}: {} is none of glTF's values", name_, index, field, value);
  };
  const auto wrap = [](int value) -> std::optional<TextureWrap> {
    switch (value) {
      case TINYGLTF_TEXTURE_WRAP_REPEAT:
        return TextureWrap::repeat;
      case TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT:
        return TextureWrap::mirrored;
      case TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE:
        return TextureWrap::clamp;
      default:
        return std::nullopt;
    }
  };
  const auto s = wrap(from.wrapS);
  const auto t = wrap(from.wrapT);
  if (!s) return unknown("wrapS", from.wrapS);
  if (!t) return unknown("wrapT", from.wrapT);
  result.wrap_s = *s;
  result.wrap_t = *t;
  if (from.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST) {
    result.smooth_near = false;
  } else if (from.magFilter >= 0 && from.magFilter != TINYGLTF_TEXTURE_FILTER_LINEAR) {
    return unknown("magFilter", from.magFilter);
  }
  switch (from.minFilter) {
    case TINYGLTF_TEXTURE_FILTER_NEAREST:
    case TINYGLTF_TEXTURE_FILTER_LINEAR:
      result.mipmaps = TextureMipmaps::none;
      break;
    case TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_NEAREST:
    case TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_NEAREST:
      result.mipmaps = TextureMipmaps::nearest;
      break;
    case TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_LINEAR:
    case TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_LINEAR:
      break;
    default:
      if (from.minFilter >= 0) return unknown("minFilter", from.minFilter);
  }
  result.smooth_far = from.minFilter != TINYGLTF_TEXTURE_FILTER_NEAREST &&
                      from.minFilter != TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_NEAREST &&
                      from.minFilter != TINYGLTF_TEXTURE_FILTER_NEAREST_MIPMAP_LINEAR;
  return result;
}

template <class Info>
Result<MaterialTexture> GltfReader::texture(const Info& info, const std::string& what,
                                            std::vector<int>& texcoord_sets) {
  MaterialTexture result;
  if (info.index < 0) return result;
  if (info.extensions.contains("KHR_texture_transform")) {
    model_.warnings.push_back(
        fmt::format("{}: {}: its KHR_texture_transform is left out; apply it "
                    "to the texture coordinates",
                    name_, what));
  }
  const Result<int> picture = image(info.index, what);
  if (!picture) return tl::unexpected(picture.error());
  const Result<TextureSampling> sampled =
      sampling(gltf_.textures[static_cast<std::size_t>(info.index)].sampler);
  if (!sampled) return tl::unexpected(sampled.error());
  auto set = std::ranges::find(texcoord_sets, info.texCoord);
  if (set == texcoord_sets.end()) {
    if (texcoord_sets.size() == 2) {
      model_.warnings.push_back(
          fmt::format("{}: {}: is left out: it is the third of its material's "
                      "textures that are laid out in "
                      "different ways",
                      name_, what));
      return result;
    }
    texcoord_sets.push_back(info.texCoord);
    set = texcoord_sets.end() - 1;
  }
  result.image = *picture;
  result.texcoords = static_cast<int>(set - texcoord_sets.begin());
  result.sampling = *sampled;
  return result;
}

// The picture of a texture.
Result<int> GltfReader::image(int index, const std::string& what) {
  if (!has(gltf_.textures, index)) {
    return fail("{}: {}: names texture {}, there are {}", name_, what, index,
                gltf_.textures.size());
  }
  const int source = gltf_.textures[static_cast<std::size_t>(index)].source;
  if (!has(gltf_.images, source)) {
    return fail("{}: textures/{}: names image {}, there are {}", name_, index, source,
                gltf_.images.size());
  }
  const auto known = image_index_.find(source);
  if (known != image_index_.end()) return known->second;
  const tinygltf::Image& image = gltf_.images[static_cast<std::size_t>(source)];
  const std::string place = fmt::format("{}: images/{}", name_, source);
  std::span<const std::uint8_t> coded(image.image);
  if (image.bufferView >= 0) {
    const Result<std::span<const std::uint8_t>> view =
        view_bytes(image.bufferView, fmt::format("images/{}", source));
    if (!view) return tl::unexpected(view.error());
    coded = *view;
  }
  if (coded.empty()) {
    return fail("{}: {} can't be read; put it beside the model or embed it", place,
                image.uri.empty() ? "its data" : image.uri.substr(0, 80));
  }
  const Result<int> added = add_texture(model_, coded, place, limits_);
  if (added) image_index_.emplace(source, *added);
  return added;
}

Result<void> GltfReader::read_materials() {
  for (std::size_t i = 0; i < gltf_.materials.size(); ++i) {
    const tinygltf::Material& from = gltf_.materials[i];
    const tinygltf::PbrMetallicRoughness& pbr = from.pbrMetallicRoughness;
    const std::string what = fmt::format("materials/{}", i);
    const bool shaped = pbr.baseColorFactor.size() == 4 &&
                        (from.emissiveFactor.empty() || from.emissiveFactor.size() == 3);
    if (!shaped) return fail("{}: {}: a colour has the wrong number of components", name_, what);
    Material material;
    material.name = from.name.empty() ? what : from.name;
    for (int c = 0; c < 4; ++c) {
      material.base_color[c] = static_cast<float>(pbr.baseColorFactor[static_cast<std::size_t>(c)]);
    }
    if (from.alphaMode == "MASK") {
      material.alpha_mode = AlphaMode::mask;
      material.alpha_cutoff = static_cast<float>(from.alphaCutoff);
    } else if (from.alphaMode == "BLEND") {
      material.alpha_mode = AlphaMode::blend;
    } else if (from.alphaMode == "OPAQUE") {
      material.base_color.a = 1.0F;
    } else {
      return fail("{}: {}/alphaMode: \"{}\" is none of OPAQUE, MASK and BLEND", name_, what,
                  from.alphaMode.substr(0, 40));
    }
    for (int c = 0; c < 3 && !from.emissiveFactor.empty(); ++c) {
      material.emissive[c] = static_cast<float>(from.emissiveFactor[static_cast<std::size_t>(c)]);
    }
    material.metallic = static_cast<float>(pbr.metallicFactor);
    material.roughness = static_cast<float>(pbr.roughnessFactor);
    material.double_sided = from.doubleSided;
    material.normal_scale = static_cast<float>(from.normalTexture.scale);
    material.occlusion_strength = static_cast<float>(from.occlusionTexture.strength);
    std::vector<int>& sets = texcoord_sets_.emplace_back();
    std::optional<Error> failed;
    const auto take = [&](MaterialTexture& to, const auto& info, const char* which) {
      if (failed) return;
      Result<MaterialTexture> taken = texture(info, what + "/" + which, sets);
      if (taken) {
        to = *taken;
      } else {
        failed = taken.error();
      }
    };
    take(material.base_color_texture, pbr.baseColorTexture, "baseColorTexture");
    take(material.metallic_roughness_texture, pbr.metallicRoughnessTexture,
         "metallicRoughnessTexture");
    take(material.normal_texture, from.normalTexture, "normalTexture");
    take(material.occlusion_texture, from.occlusionTexture, "occlusionTexture");
    take(material.emissive_texture, from.emissiveTexture, "emissiveTexture");
    if (failed) return tl::unexpected(*failed);
    model_.materials.push_back(std::move(material));
  }
  // What a primitive without a material gets, by the specification 5.19; a metal with nothing to
  // mirror would be black, so it is a plain white body here.
  Material plain;
  plain.name = "default";
  model_.materials.push_back(plain);
  return {};
}

}  // namespace penumbra
