#include "calib/solver/corner_cost.hpp"

#include <ceres/autodiff_cost_function.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <cmath>

namespace penumbra {
namespace {

constexpr double kEdgeShiftPrior = 1.0;  // sigma [px]
// Minimum derivative of the distorted radius, relative to that of an equidistant lens.
constexpr double kMinGrowth = 0.3;
constexpr double kGrowthSigma = 0.03;  // sigma of a derivative below the minimum
constexpr double kMinDepth_m = 1e-6;   // minimum depth of a point in the camera frame [m]

struct CornerCost {
  CornerTerm term;

  template <class T>
  bool operator()(const T* lens, const T* view, const T* shape, T* residual) const {
    T p[3] = {T(term.point.x()), T(term.point.y()), T(term.point.z())};
    if (term.bowed) {
      p[2] += shape[0] * term.warp.x() + shape[1] * term.warp.y() + shape[2] * term.warp.z();
    } else {
      for (int i = 0; i < 3; ++i) p[i] += shape[i];
    }
    T q[3];
    ceres::AngleAxisRotatePoint(view, p, q);
    for (int i = 0; i < 3; ++i) q[i] += view[3 + i];
    if (!(q[2] > T(kMinDepth_m))) return false;  // Ceres takes a shorter step
    std::array<T, 8> k;
    std::copy(lens + 4, lens + kLensSize, k.begin());
    T x_d;
    T y_d;
    distort<T>(term.model, k, q[0] / q[2], q[1] / q[2], x_d, y_d);
    residual[0] = lens[0] * x_d + lens[2] + view[6] * term.spread.x() - term.pixel.x();
    residual[1] = lens[1] * y_d + lens[3] + view[6] * term.spread.y() - term.pixel.y();
    return true;
  }
};

struct EdgeShiftPrior {
  template <class T>
  bool operator()(const T* view, T* residual) const {
    residual[0] = view[6] / kEdgeShiftPrior;
    return true;
  }
};

struct RationalPrior {
  double end;

  template <class T>
  bool operator()(const T* lens, T* residual) const {
    // Keeps the coefficients small; a common factor of numerator and denominator is unconstrained.
    const double t_end = std::min(end * end, 1.0);
    const T k1 = lens[4], k2 = lens[5], k3 = lens[8], k4 = lens[9], k5 = lens[10], k6 = lens[11];
    const T* const order[] = {&k1, &k4, &k2, &k5, &k3, &k6};
    for (int i = 0; i < 6; ++i) residual[i] = *order[i] * std::pow(t_end, 1 + i / 2);
    // Prefers a derivative between that of a rectilinear lens, 1, and that of an equidistant lens,
    // 1 / (1 + r^2).
    for (int i = 0; i < kGrowthSamples; ++i) {
      const double r = end * (i + 1) / kGrowthSamples;
      const double t = r * r;
      const T n = T(1.0) + t * (k1 + t * (k2 + t * k3));
      const T d = T(1.0) + t * (k4 + t * (k5 + t * k6));
      const T n_by_t = k1 + t * (2.0 * k2 + 3.0 * t * k3);
      const T d_by_t = k4 + t * (2.0 * k5 + 3.0 * t * k6);
      const T growth = n / d + 2.0 * t * (n_by_t * d - n * d_by_t) / (d * d);
      const double equidistant = 1.0 / (1.0 + t);
      residual[6 + 2 * i] = (growth - std::sqrt(equidistant)) / (0.1 + 0.5 * (1.0 - equidistant));
      const T missing = kMinGrowth * equidistant - growth;
      residual[7 + 2 * i] = missing > T(0.0) ? missing / (kGrowthSigma * equidistant) : T(0.0);
    }
    return true;
  }
};

struct OffsetPrior {
  Eigen::Vector3d sigma;
  template <class T>
  bool operator()(const T* shape, T* residual) const {
    for (int i = 0; i < 3; ++i) residual[i] = shape[i] / sigma[i];
    return true;
  }
};

}  // namespace

std::unique_ptr<ceres::CostFunction> corner_cost(const CornerTerm& term) {
  return std::make_unique<
      ceres::AutoDiffCostFunction<CornerCost, 2, kLensSize, kViewSize, kShapeSize>>(
      new CornerCost{term});
}

std::unique_ptr<ceres::CostFunction> edge_shift_prior() {
  return std::make_unique<ceres::AutoDiffCostFunction<EdgeShiftPrior, 1, kViewSize>>(
      new EdgeShiftPrior);
}

std::unique_ptr<ceres::CostFunction> rational_prior(double end) {
  return std::make_unique<
      ceres::AutoDiffCostFunction<RationalPrior, kRationalPriorSize, kLensSize>>(
      new RationalPrior{end});
}

std::unique_ptr<ceres::CostFunction> offset_prior(const Eigen::Vector3d& sigma_m) {
  return std::make_unique<ceres::AutoDiffCostFunction<OffsetPrior, kShapeSize, kShapeSize>>(
      new OffsetPrior{sigma_m});
}

}  // namespace penumbra
