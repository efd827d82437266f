// Ceres cost functions of TagGraph: residuals of a tag's corners in one frame.
#pragma once

#include <ceres/autodiff_cost_function.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "calib/solver/corner_cost.hpp"
#include "calib/solver/packed_pose.hpp"
#include "calib/survey/tag_graph.hpp"

namespace penumbra {

inline constexpr double kMinDepth_m = 1e-6;      // minimum depth of a point in the camera frame [m]
inline constexpr double kGraphShiftPrior = 0.5;  // sigma of the edge shift [px]
inline constexpr int kTagSize = 6;

// Whitened residuals of a tag's four corners in one frame.
struct SightingCost {
  const TagSighting* sighting;
  DistortionModel model;

  // Parameters: T_camera_anchor, T_anchor_tag, edge shift, lens.
  template <class T>
  bool operator()(const T* camera_pose, const T* tag_pose, const T* shift, const T* lens,
                  T* residual) const {
    return evaluate(camera_pose, tag_pose, T(1.0), shift, lens, residual);
  }

  // `scale`: true / nominal size of the tag.
  template <class T>
  bool evaluate(const T* camera_pose, const T* tag_pose, const T& scale, const T* shift,
                const T* lens, T* residual) const {
    std::array<T, 8> k;
    std::copy(lens + 4, lens + kLensSize, k.begin());
    const auto corners = tag_corners(sighting->size_m);
    std::array<T, 8> errors;
    for (std::size_t i = 0; i < 4; ++i) {
      const T p[3] = {scale * corners[i].x(), scale * corners[i].y(), T(0.0)};
      T at[3];
      ceres::AngleAxisRotatePoint(tag_pose, p, at);
      for (int j = 0; j < 3; ++j) at[j] += tag_pose[3 + j];
      T in_camera[3];
      ceres::AngleAxisRotatePoint(camera_pose, at, in_camera);
      for (int j = 0; j < 3; ++j) in_camera[j] += camera_pose[3 + j];
      if (!(in_camera[2] > T(kMinDepth_m))) return false;
      T x_d;
      T y_d;
      distort<T>(model, k, in_camera[0] / in_camera[2], in_camera[1] / in_camera[2], x_d, y_d);
      const Eigen::Vector2d& pixel = sighting->corners_px[i];
      const Eigen::Vector2d& spread = sighting->spread[i];
      errors[2 * i] = lens[0] * x_d + lens[2] + shift[0] * spread.x() - pixel.x();
      errors[2 * i + 1] = lens[1] * y_d + lens[3] + shift[0] * spread.y() - pixel.y();
    }
    for (int i = 0; i < 8; ++i) {
      residual[i] = T(0.0);
      for (int j = 0; j <= i; ++j)
        residual[i] += sighting->whitening(i, j) * errors[static_cast<std::size_t>(j)];
    }
    return true;
  }
};
using SightingFunction =
    ceres::AutoDiffCostFunction<SightingCost, 8, kTagSize, kTagSize, 1, kLensSize>;

// Like SightingCost, with fixed camera and lens and a free tag size.
struct SizedSightingCost {
  SightingCost cost;
  Pose6 camera_pose;
  double shift;
  LensParameters lens;

  // Parameters: T_anchor_tag, logarithm of (true / nominal size).
  template <class T>
  bool operator()(const T* tag_pose, const T* log_scale, T* residual) const {
    std::array<T, 6> camera;
    std::array<T, kLensSize> with;
    const auto constant = [](double x) { return T(x); };
    std::transform(camera_pose.begin(), camera_pose.end(), camera.begin(), constant);
    std::transform(lens.begin(), lens.end(), with.begin(), constant);
    const T moved(shift);
    using std::exp;
    return cost.evaluate(camera.data(), tag_pose, T(exp(log_scale[0])), &moved, with.data(),
                         residual);
  }
};
using SizedSightingFunction = ceres::AutoDiffCostFunction<SizedSightingCost, 8, kTagSize, 1>;

}  // namespace penumbra
