#include "calib/corner_cost.hpp"

#include <ceres/autodiff_cost_function.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>

namespace penumbra {
namespace {

constexpr double kEdgeShiftPrior = 1.0;  // [px]
constexpr double kNearest = 1e-6;        // [m] in front of the camera

struct CornerCost {
  CornerTerm term;

  template <class T>
  bool operator()(const T* lens, const T* view, const T* shape, T* residual) const {
    T p[3] = {T(term.point.x()), T(term.point.y()), T(term.point.z())};
    if (term.bowed) {
      p[2] += shape[0] * term.bow.x() + shape[1] * term.bow.y() + shape[2] * term.bow.z();
    } else {
      for (int i = 0; i < 3; ++i) p[i] += shape[i];
    }
    T q[3];
    ceres::AngleAxisRotatePoint(view, p, q);
    for (int i = 0; i < 3; ++i) q[i] += view[3 + i];
    if (!(q[2] > T(kNearest))) return false;  // Ceres takes a shorter step
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

std::unique_ptr<ceres::CostFunction> offset_prior(const Eigen::Vector3d& sigma_m) {
  return std::make_unique<ceres::AutoDiffCostFunction<OffsetPrior, kShapeSize, kShapeSize>>(
      new OffsetPrior{sigma_m});
}

}  // namespace penumbra
