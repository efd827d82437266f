// The grid of directions that kernels are made for (docs/shadows.md#kernel-directions).
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <compare>

namespace penumbra {

// A cell on three faces of a cube, given by two angles from the face's axis. Opposite directions d
// and -d share a cell.
struct KernelDirection {
  int axis = 2;  // index of the largest component
  int a = 0;     // angle towards axis + 1 (modulo 3) [steps]
  int b = 0;     // angle towards axis + 2 (modulo 3) [steps]

  // Half the diagonal of a cell is up to 1.77 degrees.
  static constexpr double kStepRad = 2.5 * 3.14159265358979323846 / 180.0;

  [[nodiscard]] static KernelDirection nearest(const Eigen::Vector3d& up) {
    KernelDirection cell;
    up.cwiseAbs().maxCoeff(&cell.axis);
    const double largest = up[cell.axis];
    cell.a = static_cast<int>(std::lround(std::atan(up[(cell.axis + 1) % 3] / largest) / kStepRad));
    cell.b = static_cast<int>(std::lround(std::atan(up[(cell.axis + 2) % 3] / largest) / kStepRad));
    return cell;
  }
  [[nodiscard]] Eigen::Vector3d up() const {
    Eigen::Vector3d d = Eigen::Vector3d::Zero();
    d[axis] = 1.0;
    d[(axis + 1) % 3] = std::tan(a * kStepRad);
    d[(axis + 2) % 3] = std::tan(b * kStepRad);
    return d.normalized();
  }
  friend auto operator<=>(const KernelDirection&, const KernelDirection&) = default;
};

}  // namespace penumbra
