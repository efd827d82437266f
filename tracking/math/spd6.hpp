// Symmetric positive definite systems of a pose's six numbers: normal equations and covariances. A
// frame solves a dozen of them, and pivots, which such matrices do not need, are most of what a
// general solver of this size takes.
#pragma once

#include <Eigen/Core>

#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// x of A x = b, and the inverse of A; of A the lower triangle is read. Where A is not positive
// definite within rounding: what Eigen's LDLT with its pivots makes of it.
[[nodiscard]] Vector6d solve_spd(const Matrix6d& A, const Vector6d& b);
[[nodiscard]] Matrix6d inverse_of_spd(const Matrix6d& A);

}  // namespace penumbra
