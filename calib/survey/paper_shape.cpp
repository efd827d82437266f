#include "calib/survey/paper_shape.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

namespace penumbra {
namespace {

// Minimum RMS height of curved paper / tag size; smaller ones are within the error of the edges.
// See docs/calibration.md#curved-paper.
constexpr double kMinCurvedHeight = 5e-4;

// Sum over frames of the equations of a tag's curvature, relative to flat paper.
struct CurvatureSum {
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();

  void add(const CurvatureEquations& equations) {
    const TagCurvature& c = equations.assumed;
    information += equations.information;
    gradient += equations.gradient + equations.information * Eigen::Vector3d(c.xx, c.xy, c.yy);
  }
  [[nodiscard]] Eigen::Vector3d solve() const {
    // Sigma of the prior: a radius of 0.5 m.
    constexpr double kPriorInformation = 0.25;  // [m^2]
    return (information + kPriorInformation * Eigen::Matrix3d::Identity()).ldlt().solve(gradient);
  }
  // Returns the decrease of the squared residuals by a curvature `c` [variances].
  [[nodiscard]] double gain(const Eigen::Vector3d& c) const {
    return 2.0 * gradient.dot(c) - c.dot(information * c);
  }
};

}  // namespace

void set_curvatures(TagSurvey& survey, std::span<const SurveyFrame> frames) {
  std::map<int, std::array<CurvatureSum, 2>> halves;  // by id of a surveyed tag
  for (const SurveyedTag& tag : survey.tags) halves[tag.tag.id];
  // Neighbouring frames have similar errors, so each half consists of up to four blocks of frames.
  const auto used = static_cast<std::size_t>(survey.frames_used);
  const std::size_t blocks = std::min<std::size_t>(8, used);
  std::size_t index = 0;  // of the frame among those used
  for (std::size_t f = 0; f < frames.size(); ++f) {
    if (!survey.cameras[f]) continue;
    const std::size_t half = index++ * blocks / used % 2;
    for (std::size_t i = 0; i < frames[f].measured.size(); ++i) {
      const auto found = halves.find(frames[f].tags[i].id);
      const auto& measured = frames[f].measured[i];
      if (measured && found != halves.end()) found->second[half].add(measured->curvature);
    }
  }
  double gain = 0.0;
  for (const auto& [id, half] : halves)
    gain += half[0].gain(half[1].solve()) + half[1].gain(half[0].solve());
  if (!(gain > 0.0)) return;
  std::map<int, TagCurvature> curvatures;  // by tag id
  // Sum over two corners and the middles of two sides: (height / size)^2.
  double squares = 0.0;
  for (const SurveyedTag& tag : survey.tags) {
    const std::array<CurvatureSum, 2>& half = halves.at(tag.tag.id);
    CurvatureSum all = half[0];
    all.information += half[1].information;
    all.gradient += half[1].gradient;
    const Eigen::Vector3d solved = all.solve();
    if (!solved.allFinite()) return;
    // Below the limit of TagMap::make(), so that the rounded number in the file is accepted.
    const double limit = 0.99 / tag.tag.size_m;
    const Eigen::Vector3d c = solved.cwiseMax(-limit).cwiseMin(limit);
    const TagCurvature& curvature = curvatures[tag.tag.id] = {c.x(), c.y(), c.z()};
    const double half_m = 0.5 * tag.tag.size_m;
    for (const auto& [x, y] : {std::pair(half_m, half_m), std::pair(half_m, -half_m),
                               std::pair(half_m, 0.0), std::pair(0.0, half_m)})
      squares += std::pow(curvature.height(x, y, tag.tag.size_m) / tag.tag.size_m, 2);
  }
  const double height = std::sqrt(squares / (4.0 * static_cast<double>(survey.tags.size())));
  survey.is_curved = height > kMinCurvedHeight;
  if (!survey.is_curved) return;
  for (SurveyedTag& tag : survey.tags) tag.tag.curvature = curvatures.at(tag.tag.id);
}

void set_corner_heights(TagSurvey& survey, const std::vector<int>& on_plane) {
  double sum = 0.0;
  int corners = 0;
  for (const SurveyedTag& tag : survey.tags) {
    if (!std::ranges::binary_search(on_plane, tag.tag.id)) continue;
    for (const Eigen::Vector3d& corner : tag.tag.corners()) {
      sum += corner.z() * corner.z();
      survey.max_corner_height_m = std::max(survey.max_corner_height_m, std::abs(corner.z()));
      ++corners;
    }
  }
  survey.corner_height_m = corners > 0 ? std::sqrt(sum / corners) : 0.0;
}

}  // namespace penumbra
