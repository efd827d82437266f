#include "tracking/math/spd6.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <cmath>
#include <limits>
#include <random>

namespace penumbra {
namespace {

// Returns Q diag Q^T with up to the given condition number, with the first three rows and columns
// scaled like translations relative to rotations.
Matrix6d random_spd(std::mt19937_64& random, double condition, double scale) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  const Matrix6d Q = Eigen::HouseholderQR<Matrix6d>(Matrix6d::NullaryExpr([&] {
                       return normal(random);
                     })).householderQ();
  Vector6d d;
  for (double& value : d) value = std::pow(condition, -uniform(random));
  Vector6d units = Vector6d::Ones();
  units.head<3>().setConstant(scale);
  const Matrix6d A =
      units.asDiagonal() * Matrix6d(Q * d.asDiagonal() * Q.transpose()) * units.asDiagonal();
  return 0.5 * (A + A.transpose());
}

TEST(Spd6, MatchesAccuracyOfPivotedLdlt) {
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  using Long6 = Eigen::Matrix<long double, 6, 6>;
  for (const double condition : {1.0, 1e3, 1e6, 1e10}) {
    for (const double scale : {1.0, 1e-4, 1e6}) {
      SCOPED_TRACE(testing::Message() << condition << " " << scale);
      double ours = 0.0;
      double theirs = 0.0;
      for (int k = 0; k < 200; ++k) {
        const Matrix6d A = random_spd(random, condition, scale);
        const Vector6d b = Vector6d::NullaryExpr([&] { return normal(random); });
        const Long6 A_long = A.cast<long double>();
        const Vector6d x = A_long.ldlt().solve(b.cast<long double>()).cast<double>();
        const Matrix6d inverse = A_long.ldlt().solve(Long6(Long6::Identity())).cast<double>();
        // Compares each entry in units of the standard deviations of its row and column.
        const Vector6d unit = inverse.diagonal().cwiseSqrt();
        const double size = x.cwiseQuotient(unit).norm();
        const auto off = [&](const Vector6d& found, const Matrix6d& found_inverse) {
          return (found - x).cwiseQuotient(unit).norm() / size +
                 (unit.cwiseInverse().asDiagonal() * (found_inverse - inverse) *
                  unit.cwiseInverse().asDiagonal())
                     .norm();
        };
        ours = std::max(ours, off(solve_spd(A, b), inverse_of_spd(A)));
        const Eigen::LDLT<Matrix6d> ldlt(A);
        theirs = std::max(theirs, off(ldlt.solve(b), ldlt.solve(Matrix6d::Identity())));
      }
      EXPECT_LT(ours, 4.0 * theirs);
      EXPECT_LT(ours, 1e-14 * condition + 1e-13);
    }
  }
}

TEST(Spd6, ReadsLowerTriangleAndReturnsSymmetricInverse) {
  std::mt19937_64 random(3);
  const Matrix6d A = random_spd(random, 100.0, 1.0);
  Matrix6d lower = A.triangularView<Eigen::Lower>();
  lower.triangularView<Eigen::StrictlyUpper>().setConstant(
      std::numeric_limits<double>::quiet_NaN());
  const Vector6d b = Vector6d::LinSpaced(-1.0, 2.0);
  EXPECT_TRUE(solve_spd(lower, b) == solve_spd(A, b));
  EXPECT_TRUE(inverse_of_spd(lower) == inverse_of_spd(A));
  EXPECT_TRUE(inverse_of_spd(A) == inverse_of_spd(A).transpose());
}

// For a matrix that is not positive definite, the result equals that of LDLT, including NaN.
TEST(Spd6, FallsBackToPivotedLdltForIndefiniteMatrix) {
  std::mt19937_64 random(5);
  const Vector6d b = Vector6d::LinSpaced(1.0, 2.0);
  const auto same = [](const auto& a, const auto& c) {
    return (a.array() == c.array() || (a.array().isNaN() && c.array().isNaN())).all();
  };
  Matrix6d singular = Matrix6d::Identity();
  singular(2, 2) = 0.0;
  Matrix6d indefinite = random_spd(random, 10.0, 1.0);
  indefinite.diagonal()[4] = -3.0;
  Matrix6d rank_one = b * b.transpose();
  Matrix6d not_finite = Matrix6d::Identity();
  not_finite(3, 1) = std::numeric_limits<double>::quiet_NaN();
  Matrix6d infinite = Matrix6d::Identity();
  infinite(0, 0) = std::numeric_limits<double>::infinity();
  for (const Matrix6d& A :
       {Matrix6d(Matrix6d::Zero()), singular, indefinite, rank_one, not_finite, infinite}) {
    SCOPED_TRACE(A);
    EXPECT_TRUE(same(solve_spd(A, b), Vector6d(A.ldlt().solve(b))));
    EXPECT_TRUE(same(inverse_of_spd(A), Matrix6d(A.ldlt().solve(Matrix6d::Identity()))));
  }
}

// The results must neither overflow nor underflow for very small and very large matrices.
TEST(Spd6, StaysAccurateForVerySmallAndLargeMatrices) {
  for (const double size : {1e-150, 1e-30, 1e30, 1e150}) {
    SCOPED_TRACE(size);
    Matrix6d A = 2.0 * Matrix6d::Identity();
    A(1, 0) = A(0, 1) = 1.0;
    const Matrix6d inverse = inverse_of_spd(size * A);
    EXPECT_NEAR(inverse(0, 0) * size, 2.0 / 3.0, 1e-12);
    EXPECT_NEAR(inverse(1, 0) * size, -1.0 / 3.0, 1e-12);
    EXPECT_NEAR(inverse(5, 5) * size, 0.5, 1e-12);
    EXPECT_NEAR(solve_spd(size * A, Vector6d::Ones())[0] * size, 1.0 / 3.0, 1e-12);
  }
}

}  // namespace
}  // namespace penumbra
