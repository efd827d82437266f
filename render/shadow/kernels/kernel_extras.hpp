// Shared by both writers of kernels into .glb files. Internal to render/shadow.
#pragma once

#include <Eigen/Core>
#include <glm/vec3.hpp>

#include "render/shadow/kernels/glb_document.hpp"
#include "render/shadow/kernels/kernel_file.hpp"

namespace penumbra {

// The object frame is z up, the file y up.
[[nodiscard]] inline Eigen::Vector3d to_file_axes(const Eigen::Vector3d& p) {
  return {p.x(), p.z(), -p.y()};
}
[[nodiscard]] inline glm::vec3 to_file_axes(const glm::vec3& p) {
  return {p.x, p.z, p.y == 0.0F ? 0.0F : -p.y};
}

// Writes into a mesh what its kernels were made for. `up`: in the axes of the mesh.
void note_kernels(GlbDocument::Json& mesh, const KernelFile& kernels, const Eigen::Vector3d& up);

}  // namespace penumbra
