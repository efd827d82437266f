// The geometry that casts: a model's triangles with welded positions, split into connected parts.
// Object frame, metres.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "render/model.hpp"

namespace penumbra {

inline constexpr std::uint32_t kNoShadowPosition = std::numeric_limits<std::uint32_t>::max();

struct ShadowMesh {
  std::vector<glm::vec3> positions;    // [m], welded at 10 um
  std::vector<std::uint32_t> indices;  // triangles; those that the welding collapsed are left out
  std::vector<std::uint32_t> part;     // one per position: which connected part it belongs to
  std::uint32_t part_count = 0;
  std::vector<std::uint32_t>
      from_source;  // model file vertex -> position here, or kNoShadowPosition for one that no
                    // mesh uses; kernel files speak of model file vertices
  // Kernels that came with the model, one per position [m], or empty; made for stored_up. Vertices
  // at one place that have different ones are positions of their own.
  std::vector<glm::vec3> stored_kernels;
  glm::vec3 stored_up{0.0F, 0.0F, 1.0F};
};

// `groups` name parts that are to be one (part_groups.hpp).
[[nodiscard]] ShadowMesh make_shadow_mesh(const Model& model,
                                          std::span<const std::string> groups = {});

}  // namespace penumbra
