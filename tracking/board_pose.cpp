#include "tracking/board_pose.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "tracking/pose_solver.hpp"

namespace penumbra {
namespace {

using Tags = std::vector<TagObservation>;

std::vector<PointObservation> points_of(const Tags& tags) {
  std::vector<PointObservation> points;
  points.reserve(4 * tags.size());
  for (const TagObservation& tag : tags) {
    for (std::size_t i = 0; i < 4; ++i) points.push_back({tag.corners_table[i], tag.corners_px[i]});
  }
  return points;
}

// Two minima are one when no corner tells them apart: their pixels differ by less than noise.
bool is_same(const CameraModel& camera, const RefinedPose& a, const RefinedPose& b,
             const std::vector<PointObservation>& points) {
  const auto T_a = a.T_table_camera.inverse();
  const auto T_b = b.T_table_camera.inverse();
  if (a.T_table_camera.rotation().angularDistance(b.T_table_camera.rotation()) > 0.02) return false;
  double sum = 0.0;
  for (const PointObservation& point : points) {
    sum += (camera.project_unchecked(T_a * point.p_table) -
            camera.project_unchecked(T_b * point.p_table))
               .squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(points.size())) < 0.02;
}

// Every distinct minimum that the closed-form starts lead to, best fit first.
std::vector<RefinedPose> minima_of(const CameraModel& camera, const Tags& tags,
                                   const RefinerOptions& options) {
  const std::vector<PointObservation> points = points_of(tags);
  std::vector<RefinedPose> minima;
  for (const CameraPose& start : solve_pose(camera, points)) {
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

std::vector<double> tag_rms(const CameraModel& camera, const Tags& tags, const CameraPose& pose) {
  const auto T_camera_table = pose.inverse();
  std::vector<double> result;
  for (const TagObservation& tag : tags) {
    double sum = 0.0;
    for (std::size_t i = 0; i < 4; ++i) {
      const std::optional<Eigen::Vector2d> pixel =
          camera.project_extended(T_camera_table * tag.corners_table[i]);
      sum += pixel ? (*pixel - tag.corners_px[i]).squaredNorm()
                   : std::numeric_limits<double>::infinity();
    }
    result.push_back(std::sqrt(sum / 4.0));
  }
  return result;
}

// Whether every tag agrees with the pose about as well as the others do. The middle one of the
// RMS's (the lower of two) is what "the others" means.
bool all_agree(const std::vector<double>& rms, const BoardPoseOptions& options) {
  std::vector<double> sorted = rms;
  std::sort(sorted.begin(), sorted.end());
  const double middle = sorted[(sorted.size() - 1) / 2];
  return sorted.back() <= std::max(options.outlier_px, options.outlier_times_median * middle);
}

}  // namespace

double BoardPose::ambiguity_ratio() const {
  if (!second) return std::numeric_limits<double>::infinity();
  return best.rms_px > 0.0 ? second->rms_px / best.rms_px : std::numeric_limits<double>::infinity();
}

Result<BoardPose> estimate_board_pose(const CameraModel& camera,
                                      std::span<const TagObservation> tags,
                                      const BoardPoseOptions& options) {
  Tags used;
  for (const TagObservation& tag : tags) {
    const bool finite = std::all_of(tag.corners_px.begin(), tag.corners_px.end(),
                                    [](const Eigen::Vector2d& p) { return p.allFinite(); }) &&
                        std::all_of(tag.corners_table.begin(), tag.corners_table.end(),
                                    [](const Eigen::Vector3d& p) { return p.allFinite(); });
    if (finite) used.push_back(tag);
  }
  if (used.empty()) return fail("no tag of the table in view");

  BoardPose result;
  std::vector<RefinedPose> minima = minima_of(camera, used, options.refiner);
  const auto agrees = [&](const std::vector<RefinedPose>& poses, const Tags& of) {
    return !poses.empty() && all_agree(tag_rms(camera, of, poses.front().T_table_camera), options);
  };
  // A tag that was moved, misread or half hidden pulls at all the others, so that its own error
  // need not be the largest: leave out the one without which the rest fits best, again and again,
  // as long as those that stay are the majority.
  const std::size_t total = used.size();
  Tags rest = used;
  std::vector<RefinedPose> rest_minima = minima;
  std::vector<int> left_out;
  while (!agrees(rest_minima, rest)) {
    if (rest.size() <= 2 || 2 * (rest.size() - 1) <= total) break;
    constexpr std::size_t kMostToTry = 12;  // more tags than this outvote one: take the worst
    std::size_t first = 0;
    std::size_t last = rest.size();
    if (rest.size() > kMostToTry && !rest_minima.empty()) {
      const std::vector<double> rms = tag_rms(camera, rest, rest_minima.front().T_table_camera);
      first = static_cast<std::size_t>(std::max_element(rms.begin(), rms.end()) - rms.begin());
      last = first + 1;
    }
    std::size_t best = first;
    std::vector<RefinedPose> best_minima;
    for (std::size_t i = first; i < last; ++i) {
      Tags trial = rest;
      trial.erase(trial.begin() + static_cast<std::ptrdiff_t>(i));
      std::vector<RefinedPose> trial_minima = minima_of(camera, trial, options.refiner);
      if (trial_minima.empty()) continue;
      if (best_minima.empty() || trial_minima.front().rms_px < best_minima.front().rms_px) {
        best = i;
        best_minima = std::move(trial_minima);
      }
    }
    left_out.push_back(rest[best].id);
    rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(best));
    rest_minima = std::move(best_minima);
  }
  if (agrees(rest_minima, rest)) {
    used = std::move(rest);
    minima = std::move(rest_minima);
    result.left_out = std::move(left_out);
  } else {
    result.contradictory = true;
  }
  if (minima.empty()) return fail("the corners in view do not fix a pose");
  result.best = minima.front();
  if (minima.size() > 1) result.second = minima[1];
  result.tags_used = static_cast<int>(used.size());
  return result;
}

}  // namespace penumbra
