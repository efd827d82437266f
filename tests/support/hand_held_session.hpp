// A hand-held camera over a flat or bent sheet, for tests of errors that all frames share.
#pragma once

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "support/random_session.hpp"
#include "support/synthetic_view.hpp"

namespace penumbra::test {

// A hand-held camera over a sheet of 4 x 3 tags.
inline Session hand_held_session(std::uint64_t seed) {
  Session session;
  RandomNumbers draw(seed);
  CameraParameters p = lens_camera(Lens::plumb_bob, 640, 480, 0.85).parameters();
  p.tone_curve = 1.0;
  session.camera = CameraModel::make(p).value();
  session.tags = layout_of(Layout::sheet, draw);
  session.motion.distance = {0.45, 0.08, 0.5, 0.3};
  session.motion.elevation = {0.9, 0.4, 1.1, 1.0};
  session.motion.azimuth = {0.4, 0.3, 0.4, 2.0};
  session.motion.x = {0.0, 0.04, 0.9, 0.0};
  session.motion.y = {0.0, 0.04, 0.7, 1.5};
  session.light.noise_grey = 2.0;
  session.light.samples = 64;
  session.light.seed = seed;
  return session;
}

// Returns the tags of a flat sheet on a sheet that rises towards two of its sides.
inline std::vector<MappedTag> bent_sheet(std::vector<MappedTag> tags) {
  for (MappedTag& tag : tags) {
    Eigen::Vector3d at = tag.T_table_tag.translation();
    at.z() = 0.5 * at.x() * at.x();
    const Eigen::Quaterniond slope(Eigen::AngleAxisd(-std::atan(at.x()), Eigen::Vector3d::UnitY()));
    tag.T_table_tag = {slope, at};
  }
  return tags;
}

}  // namespace penumbra::test
