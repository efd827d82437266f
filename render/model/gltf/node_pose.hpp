// The values by which an animation replaces those of a node.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <optional>
#include <vector>

namespace penumbra::gltf {

struct NodePose {
  std::optional<Eigen::Vector3d> translation;
  std::optional<Eigen::Quaterniond> rotation;
  std::optional<Eigen::Vector3d> scale;
  std::vector<double> weights;  // of the morph targets; empty: the node's own
};
using NodePoses = std::map<int, NodePose>;  // by node

// Returns the rotation of a quaternion in glTF's order (x, y, z, w), or nullopt if it is not unit.
inline std::optional<Eigen::Quaterniond> rotation_of(const double* xyzw) {
  const Eigen::Quaterniond rotation(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
  if (!(std::abs(rotation.norm() - 1.0) < 0.1)) return std::nullopt;
  return rotation.normalized();
}

}  // namespace penumbra::gltf
