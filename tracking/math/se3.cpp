#include "tracking/math/se3.hpp"

#include <cmath>

namespace penumbra {

Eigen::Isometry3d exp_se3(const Vector6d& xi) {
  const Eigen::Vector3d nu = xi.head<3>();
  const Eigen::Vector3d omega = xi.tail<3>();
  const double angle = omega.norm();
  const Eigen::Matrix3d W = skew(omega);
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d V = Eigen::Matrix3d::Identity();
  if (angle < 1e-6) {
    R += W + 0.5 * W * W;
    V += 0.5 * W + W * W / 6.0;
  } else {
    const double a2 = angle * angle;
    R += std::sin(angle) / angle * W + (1.0 - std::cos(angle)) / a2 * W * W;
    V += (1.0 - std::cos(angle)) / a2 * W + (angle - std::sin(angle)) / (a2 * angle) * W * W;
  }
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = R;
  T.translation() = V * nu;
  return T;
}

Vector6d log_se3(const Eigen::Isometry3d& T) {
  Eigen::Quaterniond q(T.linear());
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const double s = q.vec().norm();
  const double angle = 2.0 * std::atan2(s, q.w());
  const Eigen::Vector3d omega =
      s < 1e-12 ? Eigen::Vector3d(2.0 * q.vec()) : Eigen::Vector3d(q.vec() * (angle / s));
  const Eigen::Matrix3d W = skew(omega);
  Eigen::Matrix3d V_inverse = Eigen::Matrix3d::Identity() - 0.5 * W;
  if (angle < 1e-4) {
    V_inverse += W * W / 12.0;
  } else {
    V_inverse +=
        (1.0 / (angle * angle) - (1.0 + std::cos(angle)) / (2.0 * angle * std::sin(angle))) * W * W;
  }
  Vector6d xi;
  xi.head<3>() = V_inverse * T.translation();
  xi.tail<3>() = omega;
  return xi;
}

}  // namespace penumbra
