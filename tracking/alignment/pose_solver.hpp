// Gauss-Newton steps on the pose of all tags together.
#pragma once

#include <optional>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"

namespace penumbra {

class PoseSolver {
 public:
  enum class StepBy {
    weights,  // the robust weights as they are
    slope,    // differentiates the robust weights as well; usually saves an iteration
  };
  struct Step {
    double moved_px = 0.0;  // by the farthest tag corner
    double sigmas = 0.0;    // length of the step [standard deviations of the pose]
  };

  explicit PoseSolver(AlignmentProblem& problem) : problem_(problem) {}

  // Forgets the residuals of another pose.
  void begin();
  // One step by all active tags; nothing where they are too few. `cutoff`: of Tukey's weights, as a
  // share of the gain; 0: none.
  [[nodiscard]] std::optional<Step> step(double cutoff, StepBy by);
  // Measures the residuals after a step by their median, which what covers a part of the tags does
  // not change.
  void measure_noise();
  void forget_noise() { noise_share_ = 0.0; }

  // Residuals of the last equations: sigma over the gain, by the median (0: unknown), and variance
  // [grey^2].
  [[nodiscard]] double noise_share() const { return noise_share_; }
  [[nodiscard]] double variance() const { return variance_; }
  // Of the left perturbation of T_camera_table, without the prior.
  [[nodiscard]] const Matrix6d& information() const { return information_; }
  [[nodiscard]] const Vector6d& last_step() const { return last_step_; }
  // Share of the equations' H that the last step was solved with.
  [[nodiscard]] double slope() const { return slope_; }
  // Where Tukey's weights end, as a share of the gain: never cut into the noise itself, and no
  // further out than its sigma asks for.
  [[nodiscard]] double tukey_share(double cutoff) const;
  // Equations of the active tags, four to a pack.
  [[nodiscard]] const std::vector<simd::TagPack>& packs() const { return packs_; }

 private:
  // Normal equations of the left perturbation of T_camera_table, gains and offsets marginalised,
  // without the prior.
  struct Equations {
    Matrix6d H;
    Vector6d g;
    double cost = 0.0;    // sum of w r^2, at the gains and offsets as they are
    double weight = 0.0;  // sum of w
  };
  void accumulate(double cutoff, Equations& equations);
  void fill_pack(AlignedTag& tag, double cutoff, simd::TagPack& pack, std::size_t lane);
  [[nodiscard]] bool take_variance(const Equations& equations);
  [[nodiscard]] double measured_slope(double cutoff) const;
  // Takes the active tags, their gains and offsets to the current pose; returns how far the
  // farthest corner moved [px].
  [[nodiscard]] double follow_tags(const Vector6d& xi, const Eigen::Isometry3d& motion);

  AlignmentProblem& problem_;
  std::vector<simd::TagPack> packs_;
  double variance_ = 0.0;
  double noise_share_ = 0.0;
  Matrix6d information_ = Matrix6d::Zero();
  Vector6d last_step_ = Vector6d::Zero();
  double slope_ = 1.0;
};

}  // namespace penumbra
