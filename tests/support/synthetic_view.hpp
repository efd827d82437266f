// Boards, cameras and noisy corners for tests with exact truth.
#pragma once

#include <cmath>
#include <random>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/units.hpp"
#include "support/cameras.hpp"
#include "tracking/detection/board_pose.hpp"

namespace penumbra::test {

// Camera that looks at the table's origin from `distance` [m], tilted from the vertical by `tilt`,
// at `azimuth`, rotated by `roll` about its optical axis [rad].
inline CameraPose looking_at_origin(double distance, double tilt, double azimuth, double roll) {
  const Eigen::Quaterniond down(0.0, 1.0, 0.0, 0.0);  // looks straight down, with x to the right
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(azimuth, Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitX()) * down *
                                      Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ());
  return {rotation, -distance * (rotation * Eigen::Vector3d::UnitZ())};
}

inline MappedTag flat_tag(int id, double x, double y, double size) {
  MappedTag tag;
  tag.id = id;
  tag.size_m = size;
  tag.T_table_tag = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(x, y, 0.0)};
  return tag;
}

// 4 x 3 tags of 40 mm, 55 mm apart: the sheet of the recordings.
inline std::vector<MappedTag> sheet() {
  std::vector<MappedTag> tags;
  for (int i = 0; i < 12; ++i)
    tags.push_back(flat_tag(i, -0.0825 + 0.055 * (i % 4), 0.055 - 0.055 * (i / 4), 0.04));
  return tags;
}

inline std::vector<TagObservation> observe(const CameraModel& camera, const CameraPose& pose,
                                           const std::vector<MappedTag>& tags, double noise_px,
                                           std::mt19937& random) {
  std::normal_distribution<double> normal;
  const auto T_camera_table = pose.inverse();
  std::vector<TagObservation> observations;
  for (const MappedTag& tag : tags) {
    TagObservation observation;
    observation.index = tag.id;
    observation.corners_map = tag.corners();
    bool seen = true;
    for (std::size_t i = 0; i < 4; ++i) {
      const auto pixel = camera.project(T_camera_table * observation.corners_map[i]);
      seen = seen && pixel;
      if (!seen) break;
      const double dx = noise_px * normal(random);
      const double dy = noise_px * normal(random);
      observation.corners_px[i] = *pixel + Eigen::Vector2d(dx, dy);
    }
    if (seen) observations.push_back(observation);
  }
  return observations;
}

inline std::vector<PointObservation> points_of(const std::vector<TagObservation>& tags) {
  std::vector<PointObservation> points;
  for (const TagObservation& tag : tags) {
    for (std::size_t i = 0; i < 4; ++i) points.push_back({tag.corners_map[i], tag.corners_px[i]});
  }
  return points;
}

}  // namespace penumbra::test
