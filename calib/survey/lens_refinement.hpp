// Lens of a tag survey: prior, solution and cross-validation (docs/calibration.md#lens-prior).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "calib/survey/tag_graph.hpp"
#include "core/camera/camera_model.hpp"

namespace penumbra {

// Returns the covariance of fx, fy, cx, cy [px] and the distortion coefficients that another focus
// typically causes.
[[nodiscard]] Eigen::MatrixXd typical_lens_prior(const CameraModel& camera);
// Returns that covariance from the standard deviations in a camera file, whose correlations are
// unknown. Returns an empty matrix if there are none for this lens model.
[[nodiscard]] Eigen::MatrixXd lens_prior_of(const CameraModel& camera,
                                            std::span<const double> standard_deviations);

// Bundle adjusts with the lens, and weighs its prior by the noise of the residuals. Returns false
// if it fails.
bool adjust_lens(TagGraph& graph);

// Returns the overlay error (1 sigma) of tracked poses by the lens, RMS over the corners of the
// overlay cube [px]; nullopt if the cube does not fit into the image. The covariance d d^T gives
// the displacement by a change d of the lens. See table_volume_uncertainty().
[[nodiscard]] std::optional<double> lens_overlay_px(const CameraModel& camera,
                                                    const Eigen::MatrixXd& covariance);

// Solves the lens from one half of the frames, and only the cameras in the other half. Returns the
// fraction by which the lens with the graph's prior reduces the squared residuals of the other
// half, relative to the lens with `other_prior` (empty: the given lens). Returns 0 if a solution
// fails.
[[nodiscard]] double lens_gain(const TagGraph& graph, const Eigen::MatrixXd& other_prior);

// Returns true if the solved lens should replace the one with `other_prior`: the sweep determines
// it, and lens_gain() is large enough.
[[nodiscard]] bool is_better_lens(const TagGraph& solved, const Eigen::MatrixXd& other_prior);

}  // namespace penumbra
