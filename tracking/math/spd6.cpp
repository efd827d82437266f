#include "tracking/math/spd6.hpp"

#include <Eigen/Cholesky>
#include <array>

namespace penumbra {
namespace {

constexpr int kSize = 6;
// Minimum pivot / diagonal element; below it, most digits are lost.
constexpr double kMinPivot = 1e-13;

// A = L D L^T, with ones on the diagonal of L.
struct Factors {
  std::array<std::array<double, kSize>, kSize> L;  // below the diagonal
  std::array<double, kSize> inverse_D;
};

// Returns false if A is not positive definite or has a NaN.
bool factorise(const Matrix6d& A, Factors& factors) {
  auto& [L, inverse_D] = factors;
  std::array<std::array<double, kSize>, kSize> scaled;  // L D
  bool positive = true;
#pragma GCC unroll 6
  for (std::size_t j = 0; j < kSize; ++j) {
    const auto column = static_cast<int>(j);
    double pivot = A(column, column);
#pragma GCC unroll 6
    for (std::size_t k = 0; k < j; ++k) pivot -= L[j][k] * scaled[j][k];
    positive = positive && pivot > kMinPivot * A(column, column);
    inverse_D[j] = 1.0 / pivot;
#pragma GCC unroll 6
    for (std::size_t i = j + 1; i < kSize; ++i) {
      double sum = A(static_cast<int>(i), column);
#pragma GCC unroll 6
      for (std::size_t k = 0; k < j; ++k) sum -= scaled[i][k] * L[j][k];
      scaled[i][j] = sum;
      L[i][j] = sum * inverse_D[j];
    }
  }
  return positive;
}

}  // namespace

Vector6d solve_spd(const Matrix6d& A, const Vector6d& b) {
  Factors factors;
  if (!factorise(A, factors)) return A.ldlt().solve(b);
  const auto& [L, inverse_D] = factors;
  std::array<double, kSize> x;
#pragma GCC unroll 6
  for (std::size_t i = 0; i < kSize; ++i) {
    x[i] = b[static_cast<int>(i)];
#pragma GCC unroll 6
    for (std::size_t k = 0; k < i; ++k) x[i] -= L[i][k] * x[k];
  }
#pragma GCC unroll 6
  for (std::size_t i = kSize; i-- > 0;) {
    x[i] *= inverse_D[i];
#pragma GCC unroll 6
    for (std::size_t k = i + 1; k < kSize; ++k) x[i] -= L[k][i] * x[k];
  }
  return Eigen::Map<const Vector6d>(x.data());
}

Matrix6d inverse_of_spd(const Matrix6d& A) {
  Factors factors;
  if (!factorise(A, factors)) return A.ldlt().solve(Matrix6d::Identity());
  const auto& [L, inverse_D] = factors;
  // M = L^-1, and A^-1 = M^T D^-1 M.
  std::array<std::array<double, kSize>, kSize> M;
#pragma GCC unroll 6
  for (std::size_t j = 0; j < kSize; ++j) {
    M[j][j] = 1.0;
#pragma GCC unroll 6
    for (std::size_t i = j + 1; i < kSize; ++i) {
      double sum = L[i][j];
#pragma GCC unroll 6
      for (std::size_t k = j + 1; k < i; ++k) sum += L[i][k] * M[k][j];
      M[i][j] = -sum;
    }
  }
  Matrix6d inverse;
#pragma GCC unroll 6
  for (std::size_t i = 0; i < kSize; ++i) {
#pragma GCC unroll 6
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = 0.0;
#pragma GCC unroll 6
      for (std::size_t k = i; k < kSize; ++k) sum += M[k][i] * inverse_D[k] * M[k][j];
      inverse(static_cast<int>(i), static_cast<int>(j)) = sum;
      inverse(static_cast<int>(j), static_cast<int>(i)) = sum;
    }
  }
  return inverse;
}

}  // namespace penumbra
