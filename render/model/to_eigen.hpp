// Conversions between glm's vectors and Eigen's.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <glm/vec3.hpp>

namespace penumbra {

[[nodiscard]] inline Eigen::Vector3d to_eigen(const glm::vec3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}
[[nodiscard]] inline glm::vec3 to_glm(const Eigen::Vector3d& p) {
  return {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())};
}
[[nodiscard]] inline bool is_finite(const glm::vec3& p) {
  return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
}

}  // namespace penumbra
