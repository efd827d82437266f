#include "calib/survey/lens_refinement.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "calib/solver/table_volume.hpp"
#include "core/statistics.hpp"

namespace penumbra {
namespace {

// Changes by another focus (1 sigma).
constexpr double kFocal = 0.01;    // relative, of the focal length
constexpr double kAspect = 0.001;  // relative, of fx / fy
constexpr double kCentre = 0.01;   // of the principal point, as a fraction of the image width
// Shift of the image's corners by the coefficients of r^2, r^4, r^6 and r^8, and by a tangential
// coefficient, as fractions of half of the diagonal.
constexpr std::array kRadial = {0.01, 0.005, 0.0025, 0.00125};
constexpr double kTangential = 0.0025;
// Minimum sigma of a parameter, relative to that of another focus. Files have 0 for coefficients
// that calibrate did not solve for.
constexpr double kMinRelative = 1e-3;

// Minimum lens_gain() of a better lens, and maximum of its lens_overlay_px() relative to the
// prior's.
constexpr double kMinGain = 0.1;
constexpr double kMaxOverlayRatio = 0.5;
// Minimum sigma of a whitened residual. Without noise, the prior would have no weight.
constexpr double kMinNoise = 0.03;

// The frames of one half; neighbouring frames have similar errors, so it has up to four blocks.
TagGraph half_of(const TagGraph& graph, std::size_t half) {
  const auto used = static_cast<std::size_t>(
      std::ranges::count_if(graph.cameras, [](const auto& pose) { return pose.has_value(); }));
  const std::size_t blocks = std::min<std::size_t>(8, used);
  TagGraph result = graph;
  std::size_t index = 0;  // of the frame among those used
  for (std::size_t f = 0; f < graph.frames.size(); ++f) {
    if (graph.cameras[f] && index++ * blocks / used % 2 != half) result.cameras[f].reset();
  }
  return result;
}

// Squared residuals of both halves, each with tags and lens of the other half.
std::optional<double> held_out_squares(const TagGraph& graph) {
  double sum = 0.0;
  for (const std::size_t half : {0U, 1U}) {
    TagGraph solved = half_of(graph, half);
    const bool is_solved = graph.lens_prior.size() > 0 ? adjust_lens(solved) : solved.adjust(false);
    if (!is_solved) return std::nullopt;
    solved.cameras = half_of(graph, 1 - half).cameras;
    const auto squares = solved.fit_cameras();
    if (!squares) return std::nullopt;
    sum += *squares;
  }
  return sum;
}

}  // namespace

Eigen::MatrixXd typical_lens_prior(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const Eigen::Index size = 4 + coefficient_count(p.model);
  const double corner = std::hypot(p.width / p.fx, p.height / p.fy) / 2.0;
  const auto radial = [&](Eigen::Index i) {
    return kRadial[static_cast<std::size_t>(i)] /
           std::pow(corner, 2.0 * static_cast<double>(i + 1));
  };
  const double tangential = kTangential / (3.0 * corner);
  Eigen::VectorXd sigma(size);
  sigma.head<4>() << std::hypot(kFocal, 0.5 * kAspect) * Eigen::Vector2d(p.fx, p.fy),
      kCentre * Eigen::Vector2d::Constant(p.width);
  const bool polynomial = is_polynomial(p.model);
  if (polynomial) sigma.segment<5>(4) << radial(0), radial(1), tangential, tangential, radial(2);
  const Eigen::Index first = polynomial ? 9 : 4;
  for (Eigen::Index i = first; i < size; ++i) sigma[i] = radial(i - first);
  Eigen::MatrixXd covariance = sigma.array().square().matrix().asDiagonal();
  covariance(0, 1) = (kFocal * kFocal - 0.25 * kAspect * kAspect) * p.fx * p.fy;
  covariance(1, 0) = covariance(0, 1);
  return covariance;
}

Eigen::MatrixXd lens_prior_of(const CameraModel& camera,
                              std::span<const double> standard_deviations) {
  const Eigen::VectorXd typical = typical_lens_prior(camera).diagonal().cwiseSqrt();
  const bool is_known =
      static_cast<Eigen::Index>(standard_deviations.size()) == typical.size() &&
      std::ranges::all_of(standard_deviations, [](double x) { return x >= 0.0 && x < 1e6; });
  if (!is_known) return {};
  const Eigen::Map<const Eigen::VectorXd> given(standard_deviations.data(), typical.size());
  return given.cwiseMax(kMinRelative * typical).cwiseAbs2().asDiagonal();
}

bool adjust_lens(TagGraph& graph) {
  graph.prior_noise = 1.0;
  constexpr int kRounds = 3;
  for (int round = 0; round < kRounds; ++round) {
    if (!graph.adjust(false)) return false;
    const Result<GraphCovariance> found = graph.covariance();
    if (!found) return false;
    graph.prior_noise = std::max(kMinNoise, found->lens_noise);
  }
  return graph.adjust(false);
}

std::optional<double> lens_overlay_px(const CameraModel& camera,
                                      const Eigen::MatrixXd& covariance) {
  const auto table = table_volume_uncertainty(camera, covariance);
  return table ? std::optional(root_mean_square(table->tracked_px)) : std::nullopt;
}

double lens_gain(const TagGraph& graph, const Eigen::MatrixXd& other_prior) {
  const auto squares = held_out_squares(graph);
  const auto others = held_out_squares(graph.with_lens_prior(other_prior));
  const double gain = squares && others ? 1.0 - *squares / *others : 0.0;
  return std::isfinite(gain) ? gain : 0.0;
}

bool is_better_lens(const TagGraph& solved, const Eigen::MatrixXd& other_prior) {
  const Result<CameraModel> camera = solved.camera();
  const Result<GraphCovariance> found = solved.covariance();
  if (!camera || !found) return false;
  const auto before_px = lens_overlay_px(*camera, solved.lens_prior);
  const auto after_px = lens_overlay_px(*camera, found->lens);
  return before_px && after_px && *after_px < kMaxOverlayRatio * *before_px &&
         lens_gain(solved, other_prior) > kMinGain;
}

}  // namespace penumbra
