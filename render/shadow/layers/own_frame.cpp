#include "render/shadow/layers/own_frame.hpp"

#include <cmath>

namespace penumbra {

OwnFrame OwnFrame::make(const Placement& T_world_object, const PlaneFrame& plane, double size,
                        int bits) {
  const Eigen::Vector3d exact_up = T_world_object.rotation.conjugate() * plane.n;
  Eigen::Vector3d up;
  for (int i = 0; i < 3; ++i) up[i] = std::ldexp(std::round(std::ldexp(exact_up[i], bits)), -bits);
  const PlaneFrame view = PlaneFrame::make(up, Eigen::Vector3d::Zero());
  Eigen::Matrix3d R_own_object;
  R_own_object.row(0) = view.e1;
  R_own_object.row(1) = view.e2;
  R_own_object.row(2) = view.n;

  OwnFrame own;
  const double height = plane.height(T_world_object.position);
  const int step = size > 0.0 ? std::ilogb(size) + 1 - bits : -bits;
  own.T_own_object.position = {0.0, 0.0, std::ldexp(std::round(std::ldexp(height, -step)), step)};
  own.T_own_object.rotation = Eigen::Quaterniond(R_own_object).normalized();
  own.T_own_object.scale = T_world_object.scale;

  // Rotation of the own frame in the plane. Apart from rounding, it is about the normal.
  const Eigen::Matrix3d R_world_own =
      T_world_object.rotation.toRotationMatrix() * R_own_object.transpose();
  const Eigen::Vector3d x = R_world_own.col(0);
  const Eigen::Vector3d y = R_world_own.col(1);
  const double along = plane.e1.dot(x) + plane.e2.dot(y);
  const double across = plane.e2.dot(x) - plane.e1.dot(y);
  const double length = std::hypot(along, across);
  own.T_plane_own.cosine = along / length;
  own.T_plane_own.sine = across / length;
  own.T_plane_own.displacement = plane.to_plane(T_world_object.position).head<2>();
  return own;
}

}  // namespace penumbra
