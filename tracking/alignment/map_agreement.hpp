// Tests whether the tags' relative poses agree with the map, using each tag's normal equations.
#pragma once

#include <span>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/pose_solver.hpp"

namespace penumbra {

// Normal equations of one tag: left perturbation of T_camera_map, gain and offset marginalised.
struct TagEquations {
  int index = 0;
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  // Perturbations that move the tag by 1 px along each image axis and by 1 rad about its ray.
  Eigen::Matrix<double, 6, 3> motions = Eigen::Matrix<double, 6, 3>::Zero();
  Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();  // inverse of the normal matrix of `motions`
  double squares = 0.0;  // squared motion preferred by the tag, weighted by the normal matrix
};

class MapAgreement {
 public:
  // Reads the result's design_effect; sets displacement_px, disagreement, map_covariance,
  // map_inconsistent and inconsistent_tag. See docs/tracking.md#map.
  void check(const AlignmentProblem& problem, const PoseSolver& solver, AlignmentResult& result);

  // Returns the motion of the camera (left perturbation of T_camera_map) from the pose of the
  // latest check to the one that fits best if the map has displaced every tag independently, with
  // this standard deviation per axis. Zero for fewer than three tags. See
  // docs/tracking.md#displaced-tags.
  [[nodiscard]] Vector6d motion_for_displaced_tags(const AlignmentProblem& problem, double variance,
                                                   double sigma_m) const;

  // Returns the equations of the tags in the latest check.
  [[nodiscard]] std::span<const TagEquations> equations() const { return equations_; }

 private:
  void collect(const AlignmentProblem& problem, const PoseSolver& solver);
  void estimate_map_error(const AlignmentProblem& problem, double variance,
                          AlignmentResult& result) const;
  // Returns the tag whose removal makes the others agree, or -1. `squares`: sum over all tags.
  [[nodiscard]] int find_outlier(double squares) const;

  std::vector<TagEquations> equations_;
};

}  // namespace penumbra
