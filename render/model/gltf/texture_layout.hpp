// Texture coordinates of a material: which attribute, and how KHR_texture_transform changes it.
#pragma once

#include <tiny_gltf.h>

#include <glm/mat2x2.hpp>
#include <glm/vec2.hpp>
#include <string>

#include "render/model/gltf/notes.hpp"

namespace penumbra::gltf {

struct TextureLayout {
  int set = 0;  // of TEXCOORD_n
  glm::dmat2 linear{1.0};
  glm::dvec2 offset{0.0};

  [[nodiscard]] bool operator==(const TextureLayout&) const = default;
  [[nodiscard]] glm::vec2 apply(const glm::dvec2& texcoord) const {
    return glm::vec2(linear * texcoord + offset);
  }
  // Returns true if the axes of the texture keep their directions on the surface.
  [[nodiscard]] bool keeps_directions() const {
    return linear[0][1] == 0.0 && linear[1][0] == 0.0 && linear[0][0] > 0.0 && linear[1][1] > 0.0;
  }
};

// Reads the texCoord and the extensions of a texture reference. A malformed transform is ignored
// with a note. `what`: JSON path of the reference.
[[nodiscard]] TextureLayout texture_layout(int texcoord, const tinygltf::ExtensionMap& extensions,
                                           const std::string& what, Notes& notes);

}  // namespace penumbra::gltf
