#include "tracking/alignment/motion_blur_check.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <tuple>

#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

// Minimum explained variance fraction of a sharp image; with a blur of 1.5 cells it is 16 / 18.
constexpr double kClear = 8.0 / 9.0;
// Factors of the variance; see docs/tracking.md#motion-blur.
constexpr double kShiftFactor =
    0.5;  // factor of a shift's variance if rotations are unobservable too
constexpr double kRotationSlopeFactor =
    0.25;  // factor of a rotation's slope variance if the motion is known
// Number of tags above which more tags do not reduce the variance of a common rotation.
constexpr double kMaxTagsForRotation = 12.0;

// Returns the fraction of the cells' variance that the model explains, by a least trimmed squares
// fit to 3/5 of the cells, which excludes occluded cells. Negative for too few cells.
double explained_by_best_cells(const float* models, const float* values, int count) {
  constexpr int kMinCells = 16;
  if (count < kMinCells) return -1.0;
  constexpr double kShare = 0.6;
  // Variance of the middle 3/5 of a normal distribution.
  constexpr double kOfNormal = 0.2145;
  constexpr int kSteps = 5;
  const auto n = static_cast<std::size_t>(count);
  const auto kept = static_cast<std::size_t>(kShare * count + 0.5);
  std::vector<std::size_t> order(n);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::vector<double> squares(n);
  double gain = 0.0;
  double spread = 0.0;       // model variance over all cells
  double unexplained = 0.0;  // residual variance of the selected 3/5
  for (int step = 0; step < kSteps; ++step) {
    const std::size_t used = step == 0 ? n : kept;
    double m = 0.0;
    double v = 0.0;
    for (std::size_t k = 0; k < used; ++k) {
      m += static_cast<double>(models[order[k]]) / static_cast<double>(used);
      v += static_cast<double>(values[order[k]]) / static_cast<double>(used);
    }
    double mm = 0.0;
    double mv = 0.0;
    for (std::size_t k = 0; k < used; ++k) {
      const double deviation = static_cast<double>(models[order[k]]) - m;
      mm += deviation * deviation;
      mv += deviation * (static_cast<double>(values[order[k]]) - v);
    }
    if (step == 0) spread = mm / static_cast<double>(n);
    if (!(mm > 0.0)) return 0.0;
    gain = mv / mm;
    for (std::size_t i = 0; i < n; ++i) {
      const double residual =
          static_cast<double>(values[i]) - v - gain * (static_cast<double>(models[i]) - m);
      squares[i] = residual * residual;
    }
    std::ranges::nth_element(order, order.begin() + static_cast<std::ptrdiff_t>(kept), {},
                             [&squares](std::size_t i) { return squares[i]; });
    unexplained = 0.0;
    for (std::size_t k = 0; k < kept; ++k)
      unexplained += squares[order[k]] / static_cast<double>(kept);
  }
  const double explained = gain * gain * spread;
  if (!(gain > 0.0) || !(explained > 0.0)) return 0.0;
  return explained / (explained + unexplained / kOfNormal);
}

Vector6d fraction_of(const std::optional<Vector6d>& motion, int share, int shares) {
  return motion ? Vector6d(static_cast<double>(share) / shares * *motion) : Vector6d::Zero();
}

}  // namespace

MotionBlurCheck::MotionBlurCheck(AlignmentProblem& problem, EdgeSampler& sampler,
                                 std::span<const TagAlignment> tags,
                                 std::span<const TagEquations> equations, double variance)
    : problem_(problem), sampler_(sampler), equations_(equations), variance_(variance) {
  // Includes unverified tags, which may be blurred.
  for (const TagAlignment& of : tags) {
    if (of.explained < 0.0) continue;
    tags_.push_back(&problem_.tags[static_cast<std::size_t>(of.index)]);
    explained_.push_back(of.explained);
  }
}

double MotionBlurCheck::median() {
  const auto middle = explained_.begin() + static_cast<std::ptrdiff_t>(explained_.size() / 2);
  std::ranges::nth_element(explained_, middle);
  return *middle;
}

MotionBlurError MotionBlurCheck::check(const std::optional<Vector6d>& motion, bool known,
                                       double longest_cells) {
  if (tags_.empty() || (motion && !motion->allFinite())) return {};
  // Uses the median, because some tags may be occluded.
  if (problem_.exposure_motion.isZero(0.0) && median() >= kClear) return {};
  const Vector6d motion_before = problem_.exposure_motion;
  measure(motion, longest_cells);
  find_fraction(motion, known);
  problem_.set_exposure_motion(motion_before);
  for (AlignedTag* tag : tags_) std::ignore = problem_.measure(*tag);
  return pose_error(motion, known);
}

// Measures the blur of each tag along the motion, and in any direction.
void MotionBlurCheck::measure(const std::optional<Vector6d>& motion, double longest_cells) {
  if (motion) problem_.set_exposure_motion(*motion);
  for (AlignedTag* tag : tags_) {
    if (!problem_.measure(*tag, BlurModel::moments)) continue;
    const int index = problem_.index_of(*tag);
    const double length_px = motion ? tag->motion_px.norm() : 0.0;
    if (longest_cells > 0.0) {
      const double cell_px =
          std::sqrt(0.5 * (tag->along_a.squaredNorm() + tag->along_b.squaredNorm()));
      any_direction_.push_back(
          {index, std::max(longest_cells * cell_px, length_px), cell_px, Eigen::Vector2d::Zero()});
    }
    if (!motion) continue;
    Eigen::Matrix2d cell_px;
    cell_px << tag->along_a, tag->along_b;
    const double cells = (cell_px.inverse() * tag->motion_px).cwiseAbs().maxCoeff();
    if (cells > 1.0)
      along_motion_.push_back({index, length_px, length_px / cells, tag->motion_px / length_px});
  }
}

// Models the image with a fraction of the motion; keeps the best fraction.
void MotionBlurCheck::try_fraction(const std::optional<Vector6d>& motion, int fraction) {
  problem_.set_exposure_motion(fraction_of(motion, fraction, kFractions));
  explained_.clear();
  for (AlignedTag* tag : tags_) {
    if (!problem_.measure(*tag, BlurModel::moments)) continue;
    if (tag->moments > 1) problem_.place_moments(*tag);
    problem_.project_lattice(*tag, 0.0);
    sampler_.free_samples();
    sampler_.read_cells(*tag);
    sampler_.average_cells(*tag);
    const double explained =
        explained_by_best_cells(tag->samples.model, tag->samples.value, tag->used);
    if (explained >= 0.0) explained_.push_back(explained);
  }
  const double median_explained = explained_.empty() ? 0.0 : median();
  if (median_explained <= best_explained_) return;
  best_explained_ = median_explained;
  best_fraction_ = fraction;
}

void MotionBlurCheck::find_fraction(const std::optional<Vector6d>& motion, bool known) {
  if (!along_motion_.empty() || !any_direction_.empty()) try_fraction(motion, 0);
  if (best_explained_ >= kClear) {  // the image is sharp
    along_motion_.clear();
    any_direction_.clear();
  }
  if (along_motion_.empty()) return;
  if (known) {
    try_fraction(motion, kFractions);
    return;
  }
  for (int k = 2; k <= kFractions; k += 2) try_fraction(motion, k);
  const int best_even = best_fraction_;
  if (best_even > 0) try_fraction(motion, best_even - 1);
  if (best_even < kFractions) try_fraction(motion, best_even + 1);
}

MotionBlurError MotionBlurCheck::pose_error(const std::optional<Vector6d>& motion,
                                            bool known) const {
  double squares = 0.0;
  // Adds a prior of 1 m and 1 rad for directions without information.
  Matrix6d H = variance_ * Matrix6d::Identity();
  for (const TagEquations& of : equations_) H += of.H;
  const Matrix6d inverse = inverse_of_spd(H);
  const auto count = static_cast<double>(equations_.size());
  const bool turns = equations_.size() > 1;
  const bool only_along = any_direction_.empty();
  std::vector<Blur> blurs = along_motion_;
  blurs.insert(blurs.end(), any_direction_.begin(), any_direction_.end());
  MotionBlurError error;
  for (const Blur& blur : blurs) {
    const bool anywhere = blur.anywhere();
    const double blurred_px = anywhere ? 0.0
                              : known  ? blur.length_px
                                       : blur.length_px * best_fraction_ / kFractions;
    const double flat_px = std::max(blurred_px - 2.0 * blur.cell_px, 0.0);
    const double away_px = anywhere || only_along ? (1.0 - std::sqrt(best_explained_)) *
                                                        (blur.cell_px + 0.5 * blur.length_px)
                                                  : 0.0;
    const double flat2 = flat_px * flat_px / 12.0;
    const double away2 = away_px * away_px;
    squares += (turns ? kShiftFactor : 1.0) * (flat2 + away2);
    const auto of = std::ranges::find(equations_, blur.index, &TagEquations::index);
    if (!turns || of == equations_.end()) continue;
    const double own2 = std::max(count / kMaxTagsForRotation, 1.0) *
                        (flat2 + (anywhere ? 1.0 : kRotationSlopeFactor) * away2);
    // Camera motions that move the tag's centre by 1 px along each image axis.
    const AlignedTag& tag = problem_.tags[static_cast<std::size_t>(blur.index)];
    Eigen::Matrix<double, 2, 3> J;
    std::ignore = problem_.camera.project_unchecked(tag.centre_point(), &J);
    Eigen::Matrix<double, 6, 2> motions = Eigen::Matrix<double, 6, 2>::Zero();
    motions.topRows<2>() = J.leftCols<2>().inverse();
    const Eigen::Matrix<double, 6, 2> moved = inverse * of->H * motions;
    if (!anywhere) {
      const Vector6d shift = moved * blur.direction;
      error.covariance += own2 * shift * shift.transpose();
    } else {
      error.covariance += 0.5 * own2 * moved * moved.transpose();
    }
  }
  // Assumes errors of 1 m and 1 rad if the image gives no information.
  if (!error.covariance.allFinite()) error.covariance.setIdentity();
  if (motion && !along_motion_.empty())
    error.motion = static_cast<double>(best_fraction_) / kFractions * *motion;
  error.shift_px = std::sqrt(squares / static_cast<double>(tags_.size()));
  return error;
}

}  // namespace penumbra
