// Estimates the pose error that motion blur hides.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/edge_samples.hpp"
#include "tracking/alignment/map_agreement.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {

// Measures the displacement of each tag that the image does not exclude, because a blurred pattern
// looks the same at many poses along the motion. See docs/tracking.md#motion-blur.
class MotionBlurCheck {
 public:
  // `tags`, `equations` and `variance` (of the residuals): results of an alignment.
  MotionBlurCheck(AlignmentProblem& problem, EdgeSampler& sampler,
                  std::span<const TagAlignment> tags, std::span<const TagEquations> equations,
                  double variance);

  // See TagAligner::motion_blur_error.
  [[nodiscard]] MotionBlurError check(const std::optional<Vector6d>& motion, bool known,
                                      double longest_cells);

 private:
  struct Blur {
    int index = 0;
    double length_px = 0.0;
    double cell_px = 0.0;                                 // of a cell in its direction
    Eigen::Vector2d direction = Eigen::Vector2d::Zero();  // zero: any
    [[nodiscard]] bool anywhere() const { return direction.isZero(0.0); }
  };
  // Number of shares of a motion that are tried.
  static constexpr int kShares = 8;

  void measure(const std::optional<Vector6d>& motion, double longest_cells);
  void explain_by(const std::optional<Vector6d>& motion, int share);
  void find_share(const std::optional<Vector6d>& motion, bool known);
  [[nodiscard]] MotionBlurError sum_up(const std::optional<Vector6d>& motion, bool known) const;
  [[nodiscard]] double median();

  AlignmentProblem& problem_;
  EdgeSampler& sampler_;
  std::span<const TagEquations> equations_;
  double variance_;
  std::vector<AlignedTag*> seen_;
  std::vector<double> shares_;  // explained, of each tag
  std::vector<Blur> along_;     // the motion
  std::vector<Blur> others_;    // in any direction
  double best_ = 0.0;           // the median share explained
  int share_ = 0;               // of the motion that explains it [1 / kShares]
};

}  // namespace penumbra
