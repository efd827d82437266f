#include "tracking/detection/board_pose.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "tracking/detection/pose_solver.hpp"

namespace penumbra {
namespace {

using Tags = std::vector<TagObservation>;

// A tag is inconsistent with the others if its RMS exceeds kOutlier_px and also either
// kOutlierMedianRatio times the median tag's RMS or kOutlierAlways_px, which blur does not cause.
constexpr double kOutlier_px = 1.5;
constexpr double kOutlierMedianRatio = 2.5;
constexpr double kOutlierAlways_px = 3.0;

std::vector<PointObservation> points_of(const Tags& tags) {
  std::vector<PointObservation> points;
  points.reserve(4 * tags.size());
  for (const TagObservation& tag : tags) {
    for (std::size_t i = 0; i < 4; ++i) points.push_back({tag.corners_map[i], tag.corners_px[i]});
  }
  return points;
}

// Returns true if two minima are practically the same pose.
bool is_same(const CameraModel& camera, const RefinedPose& a, const RefinedPose& b,
             const std::vector<PointObservation>& points) {
  const auto T_a = a.T_map_camera.inverse();
  const auto T_b = b.T_map_camera.inverse();
  if (a.T_map_camera.rotation().angularDistance(b.T_map_camera.rotation()) > 0.02) return false;
  double sum = 0.0;
  for (const PointObservation& point : points) {
    sum +=
        (camera.project_unchecked(T_a * point.p_map) - camera.project_unchecked(T_b * point.p_map))
            .squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(points.size())) < 0.02;
}

// Returns the distinct minima reached from the closed-form solutions, best fit first.
std::vector<RefinedPose> minima_of(const CameraModel& camera, const Tags& tags,
                                   const RefinerOptions& options = {}) {
  const std::vector<PointObservation> points = points_of(tags);
  std::vector<RefinedPose> minima;
  for (const MapFromCamera& start : solve_pose(camera, points)) {
    const std::optional<RefinedPose> refined = refine_pose(camera, points, start, options);
    if (refined) minima.push_back(*refined);
  }
  std::stable_sort(minima.begin(), minima.end(),
                   [](const RefinedPose& a, const RefinedPose& b) { return a.rms_px < b.rms_px; });
  std::vector<RefinedPose> distinct;
  for (const RefinedPose& minimum : minima) {
    if (std::none_of(distinct.begin(), distinct.end(), [&](const RefinedPose& other) {
          return is_same(camera, minimum, other, points);
        }))
      distinct.push_back(minimum);
  }
  return distinct;
}

using Residuals = std::array<Eigen::Vector2d, 4>;  // [px]

// Returns nullopt if a corner has no projection.
std::optional<Residuals> residuals_of(const CameraModel& camera, const TagObservation& tag,
                                      const Transform<frame::Camera, frame::Map>& T_camera_map) {
  Residuals residuals;
  for (std::size_t i = 0; i < 4; ++i) {
    const std::optional<Eigen::Vector2d> pixel =
        camera.project_extended(T_camera_map * tag.corners_map[i]);
    if (!pixel) return std::nullopt;
    residuals[i] = *pixel - tag.corners_px[i];
  }
  return residuals;
}

std::vector<double> tag_rms(const CameraModel& camera, const Tags& tags,
                            const MapFromCamera& pose) {
  const auto T_camera_map = pose.inverse();
  std::vector<double> result;
  for (const TagObservation& tag : tags) {
    const std::optional<Residuals> residuals = residuals_of(camera, tag, T_camera_map);
    double sum = residuals ? 0.0 : std::numeric_limits<double>::infinity();
    if (residuals) {
      for (const Eigen::Vector2d& r : *residuals) sum += r.squaredNorm();
    }
    result.push_back(std::sqrt(sum / 4.0));
  }
  return result;
}

// Returns true if several tags are inconsistent with the map. Noise moves each corner
// independently; a displaced tag moves its four corners together. Compares, per degree of freedom,
// the displacement of whole tags, of which the pose absorbs 6 degrees of freedom, with the scatter
// of their corners.
bool several_are_inconsistent(const CameraModel& camera, const Tags& tags,
                              const MapFromCamera& pose) {
  // Lens, tone curve and printing displace real tags by less than this [px].
  constexpr double kMinDisplacement_px = 0.5;
  // 99.9 % quantiles of the F distribution with 2 n - 6 and 6 n degrees of freedom, for 4, 5 and 6
  // tags. The value for 6 tags is an upper bound for more tags.
  constexpr std::array<double, 3> kMaxRatio = {9.4, 6.2, 5.0};
  constexpr std::size_t kMinTags = 4;
  if (tags.size() < kMinTags) return false;
  const double max_ratio = kMaxRatio[std::min(tags.size() - kMinTags, kMaxRatio.size() - 1)];
  const auto T_camera_map = pose.inverse();
  double between = 0.0;
  double within = 0.0;
  for (const TagObservation& tag : tags) {
    const std::optional<Residuals> residuals = residuals_of(camera, tag, T_camera_map);
    if (!residuals) return false;
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    for (const Eigen::Vector2d& r : *residuals) mean += r / 4.0;
    between += mean.squaredNorm();
    for (const Eigen::Vector2d& r : *residuals) within += (r - mean).squaredNorm();
  }
  const auto count = static_cast<double>(tags.size());
  if (between < kMinDisplacement_px * kMinDisplacement_px * count) return false;
  const double between_variance = 4.0 * between / (2.0 * count - 6.0);
  const double within_variance = within / (6.0 * count);
  return between_variance > max_ratio * within_variance;
}

// The tag whose removal makes the others fit best, and the minima of the others.
struct WithoutOne {
  std::size_t index = 0;
  std::vector<RefinedPose> minima;
};

WithoutOne leave_one_out(const CameraModel& camera, const Tags& tags,
                         const std::vector<double>& rms) {
  // Few iterations are sufficient to compare fits; the selected minima are refined later.
  RefinerOptions options;
  options.max_iterations = 8;
  constexpr std::size_t kMaxTries = 12;  // with more tags, tries only the worst
  WithoutOne best;
  const auto worst =
      static_cast<std::size_t>(std::max_element(rms.begin(), rms.end()) - rms.begin());
  best.index = worst;
  for (std::size_t i = 0; i < tags.size(); ++i) {
    if (tags.size() > kMaxTries && i != worst) continue;
    Tags trial = tags;
    trial.erase(trial.begin() + static_cast<std::ptrdiff_t>(i));
    std::vector<RefinedPose> minima = minima_of(camera, trial, options);
    if (minima.empty()) continue;
    if (best.minima.empty() || minima.front().rms_px < best.minima.front().rms_px) {
      best.index = i;
      best.minima = std::move(minima);
    }
  }
  return best;
}

// Tags that agree, or all tags if there is no majority.
struct Agreement {
  Tags used;
  std::vector<RefinedPose> minima;
  std::vector<int> rejected;
  bool agreed = false;
};

// Repeatedly rejects the tag whose removal makes the others fit best, while a majority remains. A
// wrong tag increases the errors of all tags, so its error may not be the largest.
Agreement reject_outliers(const CameraModel& camera, Tags used) {
  Agreement result;
  result.minima = minima_of(camera, used);
  Tags kept = used;
  std::vector<RefinedPose> kept_minima = result.minima;
  std::vector<int> rejected;
  bool agreed = false;
  while (true) {
    std::vector<double> rms(kept.size(), std::numeric_limits<double>::infinity());
    if (!kept_minima.empty()) rms = tag_rms(camera, kept, kept_minima.front().T_map_camera);
    std::vector<double> sorted = rms;
    std::sort(sorted.begin(), sorted.end());
    const double median = sorted[(sorted.size() - 1) / 2];  // for an even count, the lower one
    const double worst = sorted.back();
    agreed = worst <= kOutlier_px;
    if (agreed) break;
    const bool alike = worst <= kOutlierMedianRatio * median && worst <= kOutlierAlways_px;
    if (kept.size() <= 2 || 2 * (kept.size() - 1) <= used.size()) {
      agreed = alike;
      break;
    }
    WithoutOne without = leave_one_out(camera, kept, rms);
    // If the residuals are only noise, removing one tag does not reduce them to 1/3.
    agreed = alike && (without.minima.empty() ||
                       3.0 * without.minima.front().rms_px > kept_minima.front().rms_px);
    if (agreed) break;
    rejected.push_back(kept[without.index].index);
    kept.erase(kept.begin() + static_cast<std::ptrdiff_t>(without.index));
    kept_minima = std::move(without.minima);
  }
  // A small majority may consist of moved tags and one or two others that fit by chance.
  result.agreed = agreed && 3 * rejected.size() <= used.size();
  if (!result.agreed) {
    result.used = std::move(used);
    return result;
  }
  result.used = std::move(kept);
  if (!rejected.empty()) result.minima = minima_of(camera, result.used);
  result.rejected = std::move(rejected);
  return result;
}

}  // namespace

double BoardPose::ambiguity_ratio() const {
  if (!second) return std::numeric_limits<double>::infinity();
  return best.rms_px > 0.0 ? second->rms_px / best.rms_px : std::numeric_limits<double>::infinity();
}

bool BoardPose::is_ambiguous(double ratio) const {
  if (!second) return false;
  // Does not trust a fit better than the noise floor.
  const double floor_px = std::sqrt(2.0) * kCornerNoiseFloor_px;
  if (second->rms_px < ratio * std::max(best.rms_px, floor_px)) return true;
  // One tag has 8 equations for 6 unknowns, so a wrong pose may fit it perfectly. The second pose
  // is wrong if its log-likelihood is lower by 18 / 2, for noise of 0.3 px per axis (wrong for 1 in
  // 8000 true poses).
  constexpr double kNoise_px = 0.3;
  constexpr double kChiSquare = 18.0;
  const double noise = std::max(kNoise_px, best.noise_px);
  const double difference =
      4.0 * tags_used * (second->rms_px * second->rms_px - best.rms_px * best.rms_px);
  return difference < kChiSquare * noise * noise;
}

tl::expected<BoardPose, PoseCause> estimate_board_pose(const CameraModel& camera,
                                                       std::span<const TagObservation> tags) {
  Tags used;
  for (const TagObservation& tag : tags) {
    const bool finite = std::all_of(tag.corners_px.begin(), tag.corners_px.end(),
                                    [](const Eigen::Vector2d& p) { return p.allFinite(); }) &&
                        std::all_of(tag.corners_map.begin(), tag.corners_map.end(),
                                    [](const Eigen::Vector3d& p) { return p.allFinite(); });
    if (finite) used.push_back(tag);
  }
  if (used.empty()) return tl::unexpected(PoseCause::no_tag);

  Agreement found = reject_outliers(camera, std::move(used));
  if (found.minima.empty()) return tl::unexpected(PoseCause::undetermined);
  BoardPose result;
  result.best = found.minima.front();
  result.inconsistent =
      !found.agreed || several_are_inconsistent(camera, found.used, result.best.T_map_camera);
  if (found.minima.size() > 1) result.second = found.minima[1];
  result.points = points_of(found.used);
  result.tags_used = static_cast<int>(found.used.size());
  result.rejected = std::move(found.rejected);
  return result;
}

void finish_by_ceres(const CameraModel& camera, BoardPose& pose) {
  RefinerOptions by_ceres;
  by_ceres.by_ceres = true;
  const auto finish = [&](RefinedPose& minimum) {
    const auto finished = refine_pose(camera, pose.points, minimum.T_map_camera, by_ceres);
    if (finished) minimum = *finished;
  };
  finish(pose.best);
  if (pose.second) finish(*pose.second);
}

}  // namespace penumbra
