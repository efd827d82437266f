// Solves symmetric positive definite 6 x 6 systems without pivoting.
#pragma once

#include <Eigen/Core>

#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// Return the solution of A x = b and the inverse of A; read the lower triangle only. Fall back to
// Eigen's LDLT if A is not positive definite within rounding.
[[nodiscard]] Vector6d solve_spd(const Matrix6d& A, const Vector6d& b);
[[nodiscard]] Matrix6d inverse_of_spd(const Matrix6d& A);

}  // namespace penumbra
