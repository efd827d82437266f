// The geometry that casts: a model's triangles with welded positions, split into connected parts.
// Object frame, metres.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "render/model/model.hpp"

namespace penumbra {

inline constexpr std::uint32_t kNoShadowPosition = std::numeric_limits<std::uint32_t>::max();

struct ShadowMesh {
  std::vector<glm::vec3> positions;    // [m], welded at weld_distance()
  std::vector<std::uint32_t> indices;  // triangles, without those that the welding collapsed
  std::vector<std::uint32_t> part;     // one per position: which connected part it belongs to
  std::uint32_t part_count = 0;
  // One per part: whether a group joined several connected parts to it. Empty without groups.
  std::vector<bool> joined;
  // Faces in parts of which the welding left none: they cast nothing.
  std::size_t lost_faces = 0;
  // Model file vertex -> position here, or kNoShadowPosition if no mesh uses it. Kernel files refer
  // to model file vertices.
  std::vector<std::uint32_t> from_source;
  // Kernels that came with the model, one per position [m], or empty; made for stored_up. Vertices
  // at one place with different kernels are separate positions.
  std::vector<glm::vec3> stored_kernels;
  glm::vec3 stored_up{0.0F, 0.0F, 1.0F};
};

// Returns the distance up to which vertices are welded [m]: 10 um, at most 1e-4 of the model's
// longest side, at least the rounding of its coordinates. 0 if all vertices are at one place.
[[nodiscard]] double weld_distance(const Model& model);

// Casting of faces that are transparent in part (cut_out.hpp). Fully transparent faces cast
// nothing.
enum class CutOuts { whole_faces, what_is_seen };

// `groups` name parts that become one (part_groups.hpp). With what_is_seen the mesh has no stored
// kernels, as cutting adds corners; the pieces of a face belong to one part.
[[nodiscard]] ShadowMesh make_shadow_mesh(const Model& model,
                                          std::span<const std::string> groups = {},
                                          CutOuts cut_outs = CutOuts::whole_faces);

// Returns a warning if parts of the model cast nothing because welding collapses all their faces:
// the number of faces and the remedy. `file` is named in it.
[[nodiscard]] std::optional<std::string> warning_of_lost_faces(const Model& model,
                                                               const std::string& file);

// Names what stored kernels were made for, in one word: "GEOMETRY-PARTS-SOURCE". Files from other
// programs may omit it or hold the geometry alone; an omitted key fits any model, except for groups
// that the user names.
struct KernelStamp {
  std::string geometry;  // geometry_key() of the model
  std::string parts;     // parts_key() of its shadow mesh
  std::string source;    // KernelSource, by its name
};
[[nodiscard]] KernelStamp kernel_stamp_from(std::string_view word);

// Returns a hash of which faces belong to one part, independent of the parts' numbers.
[[nodiscard]] std::string parts_key(const ShadowMesh& mesh);

// Returns whether the kernels that came with the model fit the parts of the mesh.
[[nodiscard]] bool stored_kernels_fit(const Model& model, const ShadowMesh& mesh,
                                      std::span<const std::string> groups);

}  // namespace penumbra
