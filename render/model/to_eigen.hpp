// Points of models, as the mathematics wants them.
#pragma once

#include <Eigen/Core>
#include <glm/vec3.hpp>

namespace penumbra {

[[nodiscard]] inline Eigen::Vector3d to_eigen(const glm::vec3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

}  // namespace penumbra
