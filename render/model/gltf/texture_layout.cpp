#include "render/model/gltf/texture_layout.hpp"

#include <cmath>
#include <optional>

#include "render/model/gltf/extensions.hpp"

namespace penumbra::gltf {
namespace {

// Larger values leave floats without resolution inside a texture.
constexpr double kLargestTransform = 1e5;

// Returns the pair of numbers of a key, the default if it is absent, or nullopt if it is malformed.
std::optional<glm::dvec2> pair_of(const tinygltf::Value& from, const char* key, double absent) {
  if (!from.Has(key)) return glm::dvec2(absent);
  const tinygltf::Value& list = from.Get(key);
  if (!list.IsArray() || list.ArrayLen() != 2) return std::nullopt;
  glm::dvec2 pair(0.0);
  for (int i = 0; i < 2; ++i) {
    if (!list.Get(i).IsNumber()) return std::nullopt;
    pair[i] = list.Get(i).GetNumberAsDouble();
    if (!(std::abs(pair[i]) <= kLargestTransform)) return std::nullopt;
  }
  return pair;
}

}  // namespace

TextureLayout texture_layout(int texcoord, const tinygltf::ExtensionMap& extensions,
                             const std::string& what, Notes& notes) {
  TextureLayout layout;
  layout.set = texcoord;
  const auto extension = extensions.find(kTextureTransform);
  if (extension == extensions.end()) return layout;
  const tinygltf::Value& from = extension->second;
  if (from.Has("texCoord")) layout.set = from.Get("texCoord").GetNumberAsInt();
  const auto offset = pair_of(from, "offset", 0.0);
  const auto scale = pair_of(from, "scale", 1.0);
  const double rotation = from.Has("rotation") ? from.Get("rotation").GetNumberAsDouble() : 0.0;
  if (!offset || !scale || !(std::abs(rotation) <= kLargestTransform)) {
    notes.add("its texture transform is malformed and is ignored", what);
    return layout;
  }
  // Scales, then rotates counter-clockwise as the texture is seen (v points down), then moves.
  const double c = rotation == 0.0 ? 1.0 : std::cos(rotation);
  const double s = rotation == 0.0 ? 0.0 : std::sin(rotation);
  layout.linear = glm::dmat2(c * scale->x, -s * scale->x, s * scale->y, c * scale->y);
  layout.offset = *offset;
  return layout;
}

}  // namespace penumbra::gltf
