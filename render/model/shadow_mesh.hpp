// The geometry that casts shadows: a model's triangles with welded positions, divided into
// connected components ("parts"). Object frame, metres.
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
  std::vector<glm::vec3> positions;    // [m], welded up to weld_distance()
  std::vector<std::uint32_t> indices;  // triangles, without those collapsed by welding
  std::vector<std::uint32_t> part;     // index of the part of each position
  std::uint32_t part_count = 0;
  // One per part: whether a group joined several connected components. Empty if no part is joined.
  std::vector<bool> joined;
  // Number of faces in components that welding removed entirely; these cast no shadow.
  std::size_t lost_faces = 0;
  // For each vertex of the model file, to which kernel files refer: its index into `positions`, or
  // kNoShadowPosition if no mesh uses the vertex.
  std::vector<std::uint32_t> from_source;
  // Kernels stored with the model for stored_up, one per position [m], or empty. Vertices with
  // equal positions but different kernels are not welded.
  std::vector<glm::vec3> stored_kernels;
  glm::vec3 stored_up{0.0F, 0.0F, 1.0F};
};

// Returns the distance up to which vertices are welded [m]: 10 um, but no more than 1e-4 of the
// model's longest side and no less than the rounding of its coordinates. 0 if all vertices
// coincide.
[[nodiscard]] double weld_distance(const Model& model);

// How partially transparent faces cast (cut_out.hpp). Fully transparent faces cast no shadow.
enum class CutOuts { whole_faces, visible_regions };

// `groups`: parts to be joined (part_groups.hpp). With visible_regions, the mesh has no stored
// kernels, because cutting adds corners; the pieces of a face belong to one part.
[[nodiscard]] ShadowMesh make_shadow_mesh(const Model& model,
                                          std::span<const std::string> groups = {},
                                          CutOuts cut_outs = CutOuts::whole_faces);

// Returns a mesh in another shape of its model, without welding again. `made_from`: the shape that
// make_shadow_mesh() welded, with whole faces. Returns nullopt if the shape has other faces or
// another origin, or if vertices that were welded are more than `max_gap` [m] apart.
[[nodiscard]] std::optional<ShadowMesh> moved_to_shape(const ShadowMesh& mesh,
                                                       const Model& made_from, const Model& shape,
                                                       double max_gap);

// Returns a warning, which contains `file`, if parts of the model cast no shadow because welding
// collapses all their faces: the number of faces and the remedy.
[[nodiscard]] std::optional<std::string> warning_of_lost_faces(const Model& model,
                                                               const std::string& file);

// Identifies the model, parts and source of stored kernels, in one word: "GEOMETRY-PARTS-SOURCE".
// Files from other programs may omit it or contain the geometry alone; an omitted key matches any
// model, unless the user sets groups.
struct KernelStamp {
  std::string geometry;  // geometry_key() of the model
  std::string parts;     // parts_key() of its shadow mesh
  std::string source;    // name of the KernelSource
};
[[nodiscard]] KernelStamp kernel_stamp_from(std::string_view word);

// Returns a hash of the partition of faces into parts, independent of the parts' numbering.
[[nodiscard]] std::string parts_key(const ShadowMesh& mesh);

// Returns true if the model's stored kernels fit the parts of the mesh.
[[nodiscard]] bool stored_kernels_fit(const Model& model, const ShadowMesh& mesh,
                                      std::span<const std::string> groups);

}  // namespace penumbra
