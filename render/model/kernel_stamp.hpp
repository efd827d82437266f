// What stored kernels were made for, as one word beside them: "GEOMETRY-PARTS-SOURCE". Files from
// other programs may omit it, or hold the geometry's key alone; an omitted key counts as fitting,
// but for parts that the user names.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "render/model/shadow_mesh.hpp"

namespace penumbra {

struct KernelStamp {
  std::string geometry;  // geometry_key() of the model
  std::string parts;     // parts_key() of its shadow mesh
  std::string source;    // KernelSource, by its name
};

[[nodiscard]] inline KernelStamp kernel_stamp_from(std::string_view word) {
  KernelStamp stamp;
  const std::size_t first = word.find('-');
  stamp.geometry = word.substr(0, first);
  if (first == std::string_view::npos) return stamp;
  const std::string_view rest = word.substr(first + 1);
  const std::size_t second = rest.find('-');
  stamp.parts = rest.substr(0, second);
  if (second != std::string_view::npos) stamp.source = rest.substr(second + 1);
  return stamp;
}

// A hash of which faces belong to one part, whatever the parts are numbered by.
[[nodiscard]] std::string parts_key(const ShadowMesh& mesh);

// Whether the kernels that came with the model are for the parts that the mesh has. Where no groups
// are named the kernels' own hold.
[[nodiscard]] bool stored_kernels_fit(const Model& model, const ShadowMesh& mesh,
                                      std::span<const std::string> groups);

}  // namespace penumbra
