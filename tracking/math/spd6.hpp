// Symmetric positive definite systems of a pose, without the pivots of a general solver.
#pragma once

#include <Eigen/Core>

#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// x of A x = b, and the inverse of A, from the lower triangle; by Eigen's LDLT where A is not
// positive definite within rounding.
[[nodiscard]] Vector6d solve_spd(const Matrix6d& A, const Vector6d& b);
[[nodiscard]] Matrix6d inverse_of_spd(const Matrix6d& A);

}  // namespace penumbra
