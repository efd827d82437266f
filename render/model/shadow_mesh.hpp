// The geometry that casts: a model's triangles with welded positions, split into connected parts.
// Object frame, metres.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "render/model/model.hpp"

namespace penumbra {

inline constexpr std::uint32_t kNoShadowPosition = std::numeric_limits<std::uint32_t>::max();

struct ShadowMesh {
  std::vector<glm::vec3> positions;    // [m], welded at weld_distance()
  std::vector<std::uint32_t> indices;  // triangles; those that the welding collapsed are left out
  std::vector<std::uint32_t> part;     // one per position: which connected part it belongs to
  std::uint32_t part_count = 0;
  // One per part: whether a group joined it of several connected parts. Empty without groups.
  std::vector<bool> joined;
  // Faces of the model in parts of which the welding left none: they cast nothing.
  std::size_t lost_faces = 0;
  std::vector<std::uint32_t>
      from_source;  // model file vertex -> position here, or kNoShadowPosition for one that no
                    // mesh uses; kernel files speak of model file vertices
  // Kernels that came with the model, one per position [m], or empty; made for stored_up. Vertices
  // at one place that have different ones are positions of their own.
  std::vector<glm::vec3> stored_kernels;
  glm::vec3 stored_up{0.0F, 0.0F, 1.0F};
};

// Returns the distance up to which vertices are welded [m]: 10 um, but at most 1e-4 of the model's
// longest side, so that a model in other units keeps its faces, and at least the rounding of its
// coordinates. 0 where all vertices are at one place.
[[nodiscard]] double weld_distance(const Model& model);

// How faces that are transparent in part cast (cut_out.hpp). Faces that are transparent
// everywhere cast nothing.
enum class CutOuts { whole_faces, what_is_seen };

// `groups` name parts that become one (part_groups.hpp). With what_is_seen the mesh has no
// stored kernels: its cut faces have corners of their own. What is seen of a face belongs to one
// part.
[[nodiscard]] ShadowMesh make_shadow_mesh(const Model& model,
                                          std::span<const std::string> groups = {},
                                          CutOuts cut_outs = CutOuts::whole_faces);

// Returns a warning where parts of the model cast nothing because welding collapses all of their
// faces: the number of faces, and what to do. `file` is named in it.
[[nodiscard]] std::optional<std::string> warning_of_lost_faces(const Model& model,
                                                               const std::string& file);

}  // namespace penumbra
