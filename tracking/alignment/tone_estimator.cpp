#include "tracking/alignment/tone_estimator.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "core/propagate.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {
namespace {

constexpr double kTypicalExponent = 1.5;                  // typical exponent of a camera
constexpr double kMinExponent = 0.5, kMaxExponent = 4.0;  // range of exponents
constexpr double kMinBlur_px = 0.25, kMaxBlur_px = 1.6;
constexpr double kSettledBlur = 0.05;   // change of log(blur) at convergence
constexpr double kMaxBlurChange = 0.3;  // maximum change of log(blur) per fit
constexpr int kAlignments = 6;          // maximum per image
constexpr int kSteps = 12;              // Gauss-Newton steps
constexpr double kTukey = 4.685;        // cutoff [sigmas]
// Limits for the use of a tag.
constexpr double kMinContrast = 0.12;                 // white - black, 1 = 255 grey levels
constexpr float kBlackest = 1.0F, kWhitest = 254.0F;  // a pixel beyond is clipped [grey]
constexpr std::size_t kMinPixelsPerClipped = 50;      // maximum 1 clipped pixel in 50
constexpr std::size_t kMinPixels = 64;

constexpr int kMinImages = 5;
// Error of the exponent because real responses are not powers; see docs/tracking.md#tone-curve.
constexpr double kModelSigma = 0.1;

struct Levels {
  double black = 0.0, white = 0.0;  // in (0, 1]
};
double clamped(double level) {
  return std::clamp(level, 0.5 / 255.0, 1.0);
}

// Returns Tukey's weight of a residual in units of the cutoff.
double tukey_weight(double t) {
  const double inside = std::max(1.0 - t * t, 0.0);
  return inside * inside;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// A pixel's predicted grey level and its derivatives by exponent, log(blur) and the tag's levels.
struct Prediction {
  double value = 0.0;
  Eigen::Vector2d by_common;
  Eigen::Vector2d by_levels;
};

struct Curve {
  double exponent = 1.0;
  double black_light = 0.0, white_light = 0.0;
  double black_slope = 0.0, white_slope = 0.0;  // d light / d level
  double black_log = 0.0, white_log = 0.0;

  Curve(double g, const Levels& levels) : exponent(g) {
    black_log = std::log(levels.black);
    white_log = std::log(levels.white);
    black_light = std::exp(g * black_log);
    white_light = std::exp(g * white_log);
    black_slope = g * black_light / levels.black;
    white_slope = g * white_light / levels.white;
  }
  [[nodiscard]] Prediction at(const EdgePixel& pixel) const {
    const double m = std::clamp(static_cast<double>(pixel.model), 0.0, 1.0);
    const double light = black_light + (white_light - black_light) * m;
    const double log_light = std::log(light);
    Prediction p;
    p.value = std::exp(log_light / exponent);
    const double by_light = p.value / (exponent * light);
    const double light_by_exponent =
        black_light * black_log * (1.0 - m) + white_light * white_log * m;
    p.by_common[0] = by_light * (light_by_exponent - light * log_light / exponent);
    p.by_common[1] = by_light * (white_light - black_light) * static_cast<double>(pixel.model_blur);
    p.by_levels[0] = by_light * black_slope * (1.0 - m);
    p.by_levels[1] = by_light * white_slope * m;
    return p;
  }
};

// Returns levels from a linear fit; nullopt if the contrast is too small or a level is clipped.
std::optional<Levels> start_levels(std::span<const EdgePixel> pixels) {
  Eigen::Matrix2d H = Eigen::Matrix2d::Zero();
  Eigen::Vector2d g = Eigen::Vector2d::Zero();
  std::size_t clipped = 0;
  for (const EdgePixel& pixel : pixels) {
    const double m = std::clamp(static_cast<double>(pixel.model), 0.0, 1.0);
    const Eigen::Vector2d row(1.0 - m, m);
    H += row * row.transpose();
    g += row * (static_cast<double>(pixel.grey) / 255.0);
    clipped += pixel.grey <= kBlackest || pixel.grey >= kWhitest ? 1U : 0U;
  }
  const Eigen::Vector2d levels = H.ldlt().solve(g);
  if (!levels.allFinite() || levels[1] - levels[0] < kMinContrast ||
      clipped * kMinPixelsPerClipped > pixels.size())
    return std::nullopt;
  return Levels{clamped(levels[0]), clamped(levels[1])};
}

struct Fit {
  double exponent = kTypicalExponent;
  double log_blur = 0.0;  // log(blur / blur of the pixels' model)
  double sigma = 0.0;     // standard deviation of the exponent
};

// Fits all tags of an image; `pixels` must be ordered by tag.
std::optional<Fit> fit_tone(const std::vector<EdgePixel>& pixels, double start) {
  struct Tag {
    std::span<const EdgePixel> pixels;
    Levels levels;
  };
  std::vector<Tag> tags;
  for (std::size_t begin = 0; begin < pixels.size();) {
    std::size_t end = begin;
    while (end < pixels.size() && pixels[end].tag == pixels[begin].tag) ++end;
    const std::span<const EdgePixel> of_tag(pixels.data() + begin, end - begin);
    begin = end;
    if (of_tag.size() < kMinPixels) continue;
    if (const auto levels = start_levels(of_tag)) tags.push_back({of_tag, *levels});
  }
  if (tags.empty()) return std::nullopt;

  Fit fit;
  fit.exponent = start;
  double cutoff = std::numeric_limits<double>::infinity();
  std::vector<double> residuals;
  for (int step = 0; step < kSteps; ++step) {
    Eigen::Matrix2d H = Eigen::Matrix2d::Zero();
    Eigen::Vector2d g = Eigen::Vector2d::Zero();
    Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();  // scatter of the tags' gradients
    struct Marginalised {
      Eigen::Matrix2d cross;
      Eigen::Matrix2d inverse;
      Eigen::Vector2d gradient;
    };
    std::vector<Marginalised> marginalised(tags.size());
    residuals.clear();
    double weight = 0.0;
    double cost = 0.0;
    for (std::size_t k = 0; k < tags.size(); ++k) {
      Eigen::Matrix2d common = Eigen::Matrix2d::Zero();
      Eigen::Matrix2d cross = Eigen::Matrix2d::Zero();
      Eigen::Matrix2d own = Eigen::Matrix2d::Zero();
      Eigen::Vector2d g_common = Eigen::Vector2d::Zero();
      Eigen::Vector2d g_own = Eigen::Vector2d::Zero();
      const Curve curve(fit.exponent, tags[k].levels);
      for (const EdgePixel& pixel : tags[k].pixels) {
        const Prediction p = curve.at(pixel);
        // The predicted value includes the current blur to first order.
        const double r =
            static_cast<double>(pixel.grey) / 255.0 - p.value - p.by_common[1] * fit.log_blur;
        residuals.push_back(std::abs(r));
        const double w = tukey_weight(r / cutoff);
        common += w * p.by_common * p.by_common.transpose();
        cross += w * p.by_common * p.by_levels.transpose();
        own += w * p.by_levels * p.by_levels.transpose();
        g_common += w * r * p.by_common;
        g_own += w * r * p.by_levels;
        weight += w;
        cost += w * r * r;
      }
      const Marginalised& e = marginalised[k] = {cross, own.inverse(), g_own};
      if (!e.inverse.allFinite()) return std::nullopt;
      const Eigen::Vector2d g_tag = g_common - cross * e.inverse * g_own;
      H += common - cross * e.inverse * cross.transpose();
      g += g_tag;
      scatter += g_tag * g_tag.transpose();
    }
    const Eigen::Vector2d moved = H.ldlt().solve(g);
    if (!moved.allFinite()) return std::nullopt;
    const double before = fit.exponent;
    const double blur_before = fit.log_blur;
    fit.exponent = std::clamp(before + moved[0], 0.7 * before, 1.4 * before);
    fit.exponent = std::clamp(fit.exponent, kMinExponent, kMaxExponent);
    fit.log_blur = std::clamp(fit.log_blur + moved[1], -kMaxBlurChange, kMaxBlurChange);
    for (std::size_t k = 0; k < tags.size(); ++k) {
      const Marginalised& e = marginalised[k];
      const Eigen::Vector2d levels =
          e.inverse *
          (e.gradient - e.cross.transpose() *
                            Eigen::Vector2d(fit.exponent - before, fit.log_blur - blur_before));
      Levels& now = tags[k].levels;
      now.black = clamped(now.black + levels[0]);
      now.white = clamped(now.white + levels[1]);
    }
    cutoff = std::max(kTukey * 1.4826 * median(residuals), 1.0 / 255.0);
    const Eigen::Matrix2d inverse = H.inverse();
    const double variance = cost / std::max(weight, 1.0);
    // Uses the scatter of the tags if it exceeds that of independent pixels.
    fit.sigma = std::sqrt(std::max(variance * inverse(0, 0), (inverse * scatter * inverse)(0, 0)));
    if (step > 3 && std::abs(fit.exponent - before) < 1e-4) break;
  }
  if (!std::isfinite(fit.sigma) || fit.exponent <= kMinExponent || fit.exponent >= kMaxExponent)
    return std::nullopt;
  for (const Tag& tag : tags) {
    if (!(tag.levels.white > tag.levels.black)) return std::nullopt;
  }
  return fit;
}

}  // namespace

Result<ToneEstimator> ToneEstimator::create(const CameraModel& camera,
                                            std::span<const MappedTag> tags) {
  CameraParameters p = camera.parameters();
  p.tone_curve.reset();  // the unknown
  const CameraModel untoned = CameraModel::make(p).value();
  AlignmentOptions options;
  options.effort = AlignmentEffort::accurate;
  options.tone_exponent = kTypicalExponent;
  options.min_cell_px = 3.0;  // so that edges do not overlap
  PENUMBRA_TRY(TagAligner aligner, TagAligner::create(untoned, tags, options));
  return ToneEstimator(untoned, std::move(aligner));
}

bool ToneEstimator::add(ImageView luma, const CameraPose& T_table_camera) {
  if (luma.empty() || luma.width != camera_.width() || luma.height != camera_.height() ||
      !T_table_camera.is_finite())
    return false;
  AlignmentInput input;
  input.luma = luma;
  input.predicted = as_map_pose(T_table_camera);
  input.covariance = covariance_of(0.05, 0.1);
  double exponent = kTypicalExponent;
  double blur_px = blur_px_;
  for (int i = 0; i < kAlignments; ++i) {
    aligner_.set_blur(blur_px);
    aligner_.set_tone_exponent(exponent);
    const AlignmentResult result = aligner_.refine(input);
    if (!result.verified || !result.T_map_camera.is_finite()) return false;
    input.predicted = result.T_map_camera;
    const std::optional<Fit> fit = fit_tone(aligner_.edge_pixels(), exponent);
    if (!fit) return false;
    exponent = fit->exponent;
    const double blur_before = blur_px;
    blur_px = blur_px * std::exp(fit->log_blur);
    if (!(blur_px > kMinBlur_px && blur_px < kMaxBlur_px)) return false;
    // Repeats the fit if the blur changed; the pose does not depend on the exponent.
    if (std::abs(std::log(blur_px / blur_before)) > kSettledBlur) continue;
    found_.push_back({exponent, fit->sigma, blur_px});
    blur_px_ = blur_px;
    return true;
  }
  return false;
}

Result<ToneEstimate> ToneEstimator::estimate() const {
  if (found_.size() < kMinImages) {
    return fail(
        "{} images with well exposed tags are too few to estimate the camera response; {} are "
        "enough",
        found_.size(), kMinImages);
  }
  std::vector<double> exponents;
  std::vector<double> blurs;
  for (const ImageTone& image : found_) {
    exponents.push_back(image.exponent);
    blurs.push_back(image.blur_px);
  }
  // Computes a weighted mean about the median, which is robust against reflections on tags.
  ToneEstimate result;
  result.images = static_cast<int>(found_.size());
  result.blur_px = median(blurs);
  const double middle = median(exponents);
  std::vector<double> distances;
  for (const double exponent : exponents) distances.push_back(std::abs(exponent - middle));
  const double spread = std::max(1.4826 * median(distances), 1e-3);
  std::vector<double> weights;
  double weight = 0.0;
  double sum = 0.0;
  for (const ImageTone& image : found_) {
    weights.push_back(tukey_weight((image.exponent - middle) / (kTukey * spread)) /
                      (image.sigma * image.sigma + spread * spread));
    weight += weights.back();
    sum += weights.back() * image.exponent;
  }
  result.exponent = sum / weight;
  double squares = 0.0;
  double worth = 0.0;
  for (std::size_t k = 0; k < found_.size(); ++k) {
    const double w = weights[k] / weight;
    const double off = found_[k].exponent - result.exponent;
    squares += w * w * std::max(off * off, found_[k].sigma * found_[k].sigma);
    worth += w;
  }
  result.sigma = std::hypot(std::sqrt(squares) / worth, kModelSigma);
  if (!(result.sigma <= kMaxToneSigma)) {
    return fail("the images determine the exponent of the camera response only to {:.2f}",
                result.sigma);
  }
  return result;
}

}  // namespace penumbra
