// Tests whether the tags lie relative to each other as the map says, by each tag's own equations.
#pragma once

#include <span>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/pose_solver.hpp"

namespace penumbra {

// Equations of one tag: left perturbation of T_camera_map, gain and offset marginalised.
struct TagEquations {
  int index = 0;
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  // Motions by a pixel along each image axis and a radian about the ray, as perturbations,
  // and the inverse of the equations for them.
  Eigen::Matrix<double, 6, 3> motions = Eigen::Matrix<double, 6, 3>::Zero();
  Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();
  double squares = 0.0;
};

class MapAgreement {
 public:
  // Sets the result's displacement_px, disagreement, map_covariance, map_inconsistent and
  // inconsistent_tag. Uses its design_effect. See docs/tracking.md#map.
  void check(const AlignmentProblem& problem, const PoseSolver& solver, AlignmentResult& result);

  // Equations of the tags in the last check.
  [[nodiscard]] std::span<const TagEquations> equations() const { return equations_; }

 private:
  void collect(const AlignmentProblem& problem, const PoseSolver& solver);
  void estimate_map_error(const AlignmentProblem& problem, double variance,
                          AlignmentResult& result) const;
  // The tag without which the others agree; -1: none. `squares`: of all tags.
  [[nodiscard]] int find_outlier(double squares) const;

  std::vector<TagEquations> equations_;
};

}  // namespace penumbra
