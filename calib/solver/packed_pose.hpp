// Poses as six numbers, for solvers.
#pragma once

#include <Eigen/Geometry>
#include <array>

#include "core/geometry/transform.hpp"

namespace penumbra {

using Pose6 = std::array<double, 6>;  // angle-axis [rad], translation [m]

template <class To, class From>
[[nodiscard]] Transform<To, From> unpacked(const Pose6& pose) {
  const Eigen::Vector3d axis(pose[0], pose[1], pose[2]);
  const double angle = axis.norm();
  return {angle < 1e-12 ? Eigen::Quaterniond::Identity()
                        : Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis / angle)),
          Eigen::Vector3d(pose[3], pose[4], pose[5])};
}

template <class To, class From>
[[nodiscard]] Pose6 packed(const Transform<To, From>& pose) {
  const Eigen::AngleAxisd turn(pose.rotation());
  const Eigen::Vector3d axis = turn.angle() * turn.axis();
  const Eigen::Vector3d& t = pose.translation();
  return {axis.x(), axis.y(), axis.z(), t.x(), t.y(), t.z()};
}

}  // namespace penumbra
