// Gauss-Newton steps on the common pose of all tags.
#pragma once

#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/sample_arena.hpp"

namespace penumbra {

// Returns the symmetric matrix given by the 21 numbers at(k) of TagPack::H_camera.
template <class At>
[[nodiscard]] Matrix6d camera_matrix(const At& at) {
  Matrix6d H;
  std::size_t k = 0;
  for (const auto& [row, column] : {std::pair(0, 0), std::pair(0, 3), std::pair(3, 3)}) {
    for (int p = 0; p < 3; ++p) {
      for (int q = row == column ? p : 0; q < 3; ++q, ++k)
        H(row + p, column + q) = H(column + q, row + p) = at(k);
    }
  }
  return H;
}

class PoseSolver {
 public:
  enum class StepBy {
    weights,  // holds the robust weights constant
    slope,    // also differentiates the robust weights; usually saves an iteration
  };
  struct Step {
    double moved_px = 0.0;  // maximum motion of a tag corner
    double sigmas = 0.0;    // length of the step [standard deviations of the pose]
  };

  explicit PoseSolver(AlignmentProblem& problem) : problem_(problem) {}

  // Discards the residuals of earlier poses.
  void begin();
  // Moves the pose by a step; nullopt for too few samples. `cutoff`: see tukey_share(); 0: none.
  [[nodiscard]] std::optional<Step> step(double cutoff, StepBy by);
  // Sets noise_share() from the residuals' median, which is robust against occlusion.
  void measure_noise();
  void forget_noise() { noise_share_ = 0.0; }

  // Returns the residuals' sigma as a fraction of the gain; 0: unknown.
  [[nodiscard]] double noise_share() const { return noise_share_; }
  [[nodiscard]] double variance() const { return variance_; }  // residual variance [grey^2]
  // Information of the left perturbation of T_camera_map, without the prior of the pose. If the
  // velocity is solved for, it is marginalised, with its prior for a known pose.
  [[nodiscard]] const Matrix6d& information() const { return information_; }
  // Information of [xi; w] (see MotionPrior) without the prior, if the velocity is solved for. The
  // acceleration is marginalised.
  [[nodiscard]] const Matrix12d& motion_information() const { return motion_information_; }
  // Returns the latest step at the time of the tag's row, with the acceleration.
  [[nodiscard]] Vector6d last_step_of(const AlignedTag& tag) const {
    if (!problem_.motion_prior) return last_step_;
    const double t = problem_.read_time_s(tag);
    return last_step_ + tag.motion_by_velocity * last_velocity_step_ + 0.5 * t * t * acceleration_;
  }
  // Returns the latest step's squared length [standard deviations of the image's information].
  [[nodiscard]] double last_step_squares() const {
    return problem_.motion_prior ? motion_squares_ : last_step_.dot(information_ * last_step_);
  }
  // Factor by which the latest step scaled the equations' H.
  [[nodiscard]] double slope() const { return slope_; }
  // Returns the cutoff of Tukey's weights for the noise [fraction of the gain], at most `cutoff`.
  [[nodiscard]] double tukey_share(double cutoff) const;
  // Equations of the active tags, four per pack.
  [[nodiscard]] const std::vector<simd::TagPack>& packs() const { return packs_; }

 private:
  // Left perturbation of T_camera_map, gains and offsets marginalised, without prior.
  struct Equations {
    Matrix6d H;
    Vector6d g;
    double cost = 0.0;    // sum of w r^2, at the current gains and offsets
    double weight = 0.0;  // sum of w
  };
  void accumulate(double cutoff, Equations& equations);
  void fill_pack(AlignedTag& tag, double cutoff, simd::TagPack& pack, std::size_t lane);
  [[nodiscard]] bool update_variance(const Equations& equations);
  // Moves pose and velocity.
  [[nodiscard]] std::optional<Step> step_motion(const Equations& equations, StepBy by);
  [[nodiscard]] double measured_slope(double cutoff) const;
  // Updates the active tags after a step; returns the maximum motion of a tag corner [px].
  [[nodiscard]] double follow_tags(const Vector6d& xi, const Eigen::Isometry3d& motion);
  [[nodiscard]] double follow_tags_by_row(const Vector6d& xi, const Vector6d& velocity_step);
  [[nodiscard]] simd::CameraStep camera_step(const Vector6d& xi,
                                             const Eigen::Isometry3d& motion) const;
  [[nodiscard]] double update_tags();

  AlignmentProblem& problem_;
  std::vector<simd::TagPack> packs_;
  double variance_ = 0.0;
  double noise_share_ = 0.0;
  Matrix6d information_ = Matrix6d::Zero();
  Vector6d last_step_ = Vector6d::Zero();
  double slope_ = 1.0;
  // Set if the velocity is solved for.
  Matrix12d motion_information_ = Matrix12d::Zero();
  Vector6d last_velocity_step_ = Vector6d::Zero();
  Vector6d acceleration_ = Vector6d::Zero();  // of T_camera_map, by the latest step
  double motion_squares_ = 0.0;
  simd::TagPack scratch_;
};

// Returns the design effect: variance of an edge's mean displacement divided by that for
// independent residuals. `cutoff`: of the latest step. See docs/tracking.md#design-effect.
[[nodiscard]] double design_effect(const AlignmentProblem& problem, const PoseSolver& solver,
                                   SampleArena& arena, double cutoff);

}  // namespace penumbra
