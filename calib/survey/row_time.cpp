#include "calib/survey/row_time.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "tracking/detection/pose_solver.hpp"
#include "tracking/math/se3.hpp"

namespace penumbra {
namespace {

constexpr double kMaxGap_s = 0.2;      // maximum time between two poses that give a velocity
constexpr double kSignificance = 3.0;  // minimum row time over its sigma
// Minimum difference from the camera file's row time over its sigma.
constexpr double kDifferenceSignificance = 5.0;
// Error of a velocity by central differences (1 sigma), for handheld cameras; tuned on the
// recording `rolling`, see docs/calibration.md#row-time.
constexpr double kVelocitySigma_m = 0.03;    // [m/s]
constexpr double kVelocitySigma_rad = 0.15;  // [rad/s]
constexpr double kCornerSigma_px = 0.1;
constexpr int kSteps = 4;  // Gauss-Newton steps of a frame's pose and velocity

using Vector12d = Eigen::Matrix<double, 12, 1>;
using Matrix12d = Eigen::Matrix<double, 12, 12>;

struct PosedFrame {
  std::size_t index = 0;  // among the frames
  FrameCorners corners;   // tag: index into TagSurvey::tags
};

std::vector<MappedTag> tags_of(const TagSurvey& survey) {
  std::vector<MappedTag> tags;
  for (const SurveyedTag& tag : survey.tags) tags.push_back(tag.tag);
  return tags;
}

// Poses a frame that the survey did not use.
std::optional<MapFromCamera> pose_of(const TagSurvey& survey, const SurveyFrame& frame) {
  std::vector<PointObservation> points;
  for (const SurveyedTag& tag : survey.tags) {
    const auto seen = std::ranges::find(frame.tags, tag.tag.id, &TagDetection::id);
    if (seen == frame.tags.end()) continue;
    const auto corners = tag_corners(tag.tag.size_m);
    for (std::size_t i = 0; i < 4; ++i)
      points.push_back({tag.tag.T_table_tag * corners[i], seen->corners_px[i]});
  }
  constexpr std::size_t kMinPoints = 8;  // fewer have two likely poses
  if (points.size() < kMinPoints) return std::nullopt;
  const auto found = find_pose(survey.camera, points);
  return found ? std::optional(found->T_map_camera) : std::nullopt;
}

std::vector<TagCorners> corners_of(const TagSurvey& survey, const SurveyFrame& frame) {
  std::vector<TagCorners> corners;
  for (std::size_t i = 0; i < frame.tags.size(); ++i) {
    const auto tag = std::ranges::find(survey.tags, frame.tags[i].id,
                                       [](const SurveyedTag& t) { return t.tag.id; });
    if (tag == survey.tags.end()) continue;
    TagCorners& seen = corners.emplace_back();
    seen.tag = static_cast<std::size_t>(tag - survey.tags.begin());
    const bool is_measured = i < frame.measured.size() && frame.measured[i];
    seen.corners_px = is_measured ? frame.measured[i]->corners_px : frame.tags[i].corners_px;
    seen.sigma_px =
        is_measured ? std::sqrt(frame.measured[i]->covariance.trace() / 8.0) : kCornerSigma_px;
  }
  return corners;
}

// Velocity by central differences; nullopt if the neighbours are too far away.
std::optional<Vector6d> velocity_of(std::span<const SurveyFrame> frames,
                                    std::span<const std::optional<MapFromCamera>> poses,
                                    std::size_t f) {
  const std::size_t before = f > 0 && poses[f - 1] ? f - 1 : f;
  const std::size_t after = f + 1 < frames.size() && poses[f + 1] ? f + 1 : f;
  const double gap_s = frames[after].time_s - frames[before].time_s;
  if (!(gap_s > 0.0 && gap_s < kMaxGap_s)) return std::nullopt;
  return (perturbation_between(*poses[f], *poses[after]) -
          perturbation_between(*poses[f], *poses[before])) /
         gap_s;
}

// The frames that the survey used and whose velocity is known.
std::vector<PosedFrame> posed_frames(const TagSurvey& survey, std::span<const SurveyFrame> frames) {
  std::vector<std::optional<MapFromCamera>> poses;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    poses.push_back(survey.cameras[f] ? std::optional(as_map_pose(*survey.cameras[f]))
                                      : pose_of(survey, frames[f]));
  }
  std::vector<PosedFrame> result;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    if (!survey.cameras[f]) continue;
    const std::optional<Vector6d> velocity =
        frames[f].velocity ? frames[f].velocity : velocity_of(frames, poses, f);
    if (!velocity) continue;
    PosedFrame& posed = result.emplace_back();
    posed.index = f;
    posed.corners.T_map_camera = *poses[f];
    posed.corners.velocity = *velocity;
    posed.corners.tags = corners_of(survey, frames[f]);
  }
  return result;
}

double rows_from_middle(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  return pixel.y() - 0.5 * (camera.height() - 1);
}

// Fits pose and velocity to the corners of a frame. Returns false if it fails.
bool fit_motion(const CameraModel& camera, std::span<const MappedTag> tags, FrameCorners& frame) {
  const double row_s = camera.parameters().rolling_shutter_row_s.value_or(0.0);
  const Vector6d expected = frame.velocity;
  Vector6d prior;
  prior << Eigen::Vector3d::Constant(std::pow(kVelocitySigma_m, -2)),
      Eigen::Vector3d::Constant(std::pow(kVelocitySigma_rad, -2));
  for (int step = 0; step < kSteps; ++step) {
    Matrix12d H = Matrix12d::Zero();
    Vector12d g = Vector12d::Zero();
    H.diagonal().tail<6>() = prior;
    g.tail<6>() = prior.cwiseProduct(expected - frame.velocity);
    for (const TagCorners& seen : frame.tags) {
      const MappedTag& tag = tags[seen.tag];
      const auto corners = tag_corners(tag.size_m);
      const double weight =
          1.0 / (kCornerSigma_px * kCornerSigma_px + seen.sigma_px * seen.sigma_px);
      for (std::size_t i = 0; i < 4; ++i) {
        const double time_s = row_s * rows_from_middle(camera, seen.corners_px[i]);
        const MapFromCamera pose = perturbed(frame.T_map_camera, time_s * frame.velocity);
        const Eigen::Vector3d p = tag.T_table_tag * corners[i];
        const auto pixel = camera.project(pose.inverse() * p);
        if (!pixel) return false;
        Eigen::Matrix<double, 2, 12> J;
        J.leftCols<6>() = reprojection_jacobian(camera, pose, p);
        J.rightCols<6>() = time_s * J.leftCols<6>();
        H += weight * J.transpose() * J;
        g += weight * J.transpose() * (seen.corners_px[i] - *pixel);
      }
    }
    const Vector12d x = H.ldlt().solve(g);
    if (!x.allFinite()) return false;
    frame.T_map_camera = perturbed(frame.T_map_camera, Vector6d(x.head<6>()));
    frame.velocity += x.tail<6>();
  }
  return true;
}

// Returns the point of the table's plane that is seen at a pixel.
std::optional<Eigen::Vector3d> point_on_table(const CameraModel& camera, const MapFromCamera& pose,
                                              const Eigen::Vector2d& pixel) {
  const auto ray = camera.unproject(pixel);
  if (!ray) return std::nullopt;
  const Eigen::Vector3d direction = pose.rotation() * *ray;
  const double distance = -pose.translation().z() / direction.z();
  if (!(distance > 0.0) || !std::isfinite(distance)) return std::nullopt;
  return pose.translation() + distance * direction;
}

// Moves the corners of a tag by the camera's motion between the exposures of their rows and of the
// middle row. `tag`: null if the survey rejected it; then it is taken to lie on the table.
void move_to_middle_row(const CameraModel& camera, const MappedTag* tag, const FrameCorners& frame,
                        std::array<Eigen::Vector2d, 4>& corners_px) {
  const double row_s = camera.parameters().rolling_shutter_row_s.value_or(0.0);
  for (std::size_t i = 0; i < 4; ++i) {
    const double time_s = row_s * rows_from_middle(camera, corners_px[i]);
    const MapFromCamera at_row = perturbed(frame.T_map_camera, time_s * frame.velocity);
    const auto p =
        tag != nullptr
            ? std::optional<Eigen::Vector3d>(tag->T_table_tag * tag_corners(tag->size_m)[i])
            : point_on_table(camera, at_row, corners_px[i]);
    if (!p) continue;
    const auto middle = camera.project(frame.T_map_camera.inverse() * *p);
    const auto seen = camera.project(at_row.inverse() * *p);
    if (middle && seen) corners_px[i] += *middle - *seen;
  }
}

}  // namespace

Result<CameraModel> with_row_time(const CameraModel& camera, double row_s) {
  CameraParameters parameters = camera.parameters();
  parameters.rolling_shutter_row_s = row_s;
  return CameraModel::make(parameters);
}

std::optional<RowTime> row_time_of(const CameraModel& camera, const ResidualCauses& causes,
                                   bool was_found) {
  const double given_s = camera.parameters().rolling_shutter_row_s.value_or(0.0);
  const RowTime found{given_s + causes.joint_row_time_s, causes.joint_row_time_sigma_s};
  if (causes.frames == 0 || !(found.seconds > kSignificance * found.sigma_s)) return std::nullopt;
  const double difference_s = std::abs(causes.joint_row_time_s);
  const bool differs = given_s > 0.0 ? difference_s > kDifferenceSignificance * found.sigma_s
                                     : causes.of(ErrorCause::shutter).significant;
  if (!was_found && !differs) return std::nullopt;
  return with_row_time(camera, found.seconds) ? std::optional(found) : std::nullopt;
}

std::optional<RowTime> find_row_time(const CameraModel& camera, const TagSurvey& survey,
                                     std::span<const SurveyFrame> frames, bool was_found) {
  std::vector<FrameCorners> corners;
  for (PosedFrame& posed : posed_frames(survey, frames))
    corners.push_back(std::move(posed.corners));
  return row_time_of(camera, find_residual_causes(camera, tags_of(survey), corners), was_found);
}

std::vector<SurveyFrame> at_middle_row(const CameraModel& camera, const TagSurvey& survey,
                                       std::span<const SurveyFrame> frames) {
  std::vector<SurveyFrame> result(frames.begin(), frames.end());
  if (camera.parameters().rolling_shutter_row_s.value_or(0.0) == 0.0) return result;
  const std::vector<MappedTag> tags = tags_of(survey);
  for (PosedFrame& posed : posed_frames(survey, frames)) {
    if (!fit_motion(camera, tags, posed.corners)) continue;
    SurveyFrame& frame = result[posed.index];
    for (std::size_t i = 0; i < frame.tags.size(); ++i) {
      const auto tag = std::ranges::find(survey.tags, frame.tags[i].id,
                                         [](const SurveyedTag& t) { return t.tag.id; });
      const MappedTag* placed = tag == survey.tags.end() ? nullptr : &tag->tag;
      move_to_middle_row(camera, placed, posed.corners, frame.tags[i].corners_px);
      if (i < frame.measured.size() && frame.measured[i])
        move_to_middle_row(camera, placed, posed.corners, frame.measured[i]->corners_px);
    }
  }
  return result;
}

std::optional<FrameCorners> at_middle_row(const CameraModel& camera,
                                          std::span<const MappedTag> tags, FrameCorners frame) {
  if (camera.parameters().rolling_shutter_row_s.value_or(0.0) == 0.0) return frame;
  if (!fit_motion(camera, tags, frame)) return std::nullopt;
  for (TagCorners& seen : frame.tags)
    move_to_middle_row(camera, &tags[seen.tag], frame, seen.corners_px);
  return frame;
}

}  // namespace penumbra
