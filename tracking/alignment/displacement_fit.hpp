// A pose fitted to the places where the pattern search saw the tags.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"

namespace penumbra {

// Position at which a search found a tag.
struct DisplacedTag {
  Eigen::Vector3d p;  // the tag's centre, in the table frame
  Eigen::Vector2d z;  // that in the image
  double sigma_px = 0.0;
  double cell_px = 0.0;
  bool open = false;  // its peak may go on beyond the searched window
};

// How a left perturbation of T_camera_table moves the image of a point p of the camera frame.
using PointJacobian = Eigen::Matrix<double, 2, 6>;
[[nodiscard]] PointJacobian jacobian_at(const CameraModel& camera, const Eigen::Vector3d& p);

// Fits T_camera_table, with the prediction's covariance deciding what the tags leave open.
[[nodiscard]] bool fit_displaced(const std::vector<DisplacedTag>& displaced,
                                 AlignmentProblem& problem);

// How far off the fit may have left a tag's corner [px], 1 sigma, by how well the tags agree and by
// what the prediction knows of the motions that their centres leave open: those of a row of tags
// about itself, or of what is far from all that were seen. Infinite: unknown.
[[nodiscard]] double fit_error_px(const std::vector<DisplacedTag>& displaced,
                                  const AlignmentProblem& problem);

}  // namespace penumbra
