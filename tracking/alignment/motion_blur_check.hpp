// Estimates the pose error that motion blur makes unobservable.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/edge_samples.hpp"
#include "tracking/alignment/map_agreement.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {

// Estimates how far each tag may be displaced without a visible difference, because a pattern that
// is blurred along a motion looks the same at many poses. See docs/tracking.md#motion-blur.
class MotionBlurCheck {
 public:
  // `tags`, `equations` and `variance` (of the residuals) are results of an alignment.
  MotionBlurCheck(AlignmentProblem& problem, EdgeSampler& sampler,
                  std::span<const TagAlignment> tags, std::span<const TagEquations> equations,
                  double variance);

  // See TagAligner::motion_blur_error().
  [[nodiscard]] MotionBlurError check(const std::optional<Vector6d>& motion, bool known,
                                      double longest_cells);

 private:
  struct Blur {
    int index = 0;  // index into AlignmentProblem::tags
    double length_px = 0.0;
    double cell_px = 0.0;                                 // cell width in the direction of the blur
    Eigen::Vector2d direction = Eigen::Vector2d::Zero();  // zero: any direction
    [[nodiscard]] bool anywhere() const { return direction.isZero(0.0); }
  };
  // Number of fractions of a motion that are tried.
  static constexpr int kFractions = 8;

  void measure(const std::optional<Vector6d>& motion, double longest_cells);
  void try_fraction(const std::optional<Vector6d>& motion, int fraction);  // [1 / kFractions]
  void find_fraction(const std::optional<Vector6d>& motion, bool known);
  [[nodiscard]] MotionBlurError pose_error(const std::optional<Vector6d>& motion, bool known) const;
  [[nodiscard]] double median();

  AlignmentProblem& problem_;
  EdgeSampler& sampler_;
  std::span<const TagEquations> equations_;
  double variance_;
  std::vector<AlignedTag*> tags_;
  std::vector<double> explained_;    // explained variance fraction of each tag
  std::vector<Blur> along_motion_;   // tags blurred along the motion
  std::vector<Blur> any_direction_;  // tags that may be blurred in any direction
  double best_explained_ = 0.0;      // largest median of explained_ for any fraction of the motion
  int best_fraction_ = 0;  // fraction of the motion that gives best_explained_ [1 / kFractions]
};

}  // namespace penumbra
