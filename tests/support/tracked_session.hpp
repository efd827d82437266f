// A session that is easy to track, and checks that hold for each of its poses.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/evaluation/evaluation.hpp"
#include "support/random_session.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra::test {

// A clearly visible sheet of 12 tags and a slowly moving camera.
inline Session easy_session() {
  RandomNumbers draw(5);
  Session session;
  session.camera = lens_camera(Lens::plumb_bob, 480, 360, 0.85);
  session.tags = layout_of(Layout::sheet, draw);
  session.motion = hand_motion(1, 0.42, radians(62.0), draw);
  session.light.noise_grey = 2.0;
  session.light.samples = 32;
  return session;
}

// Counts frames whose error exceeds the prediction; callers check that their fraction is small.
struct ExceededPredictions {
  int tracked = 0;   // tracked frames
  int exceeded = 0;  // tracked frames whose error exceeds 1 px and 4 times the predicted error
};

// Checks that a tracked pose is near the truth and its predicted error is consistent with its
// error. An error above 4 times the prediction is counted in `counts`; without `counts` it is a
// failure.
inline void expect_consistent(const Session& session, const PoseEstimate& pose,
                              const CameraPose& truth, ExceededPredictions* counts = nullptr) {
  if (!pose.has_pose()) return;
  EXPECT_TRUE(pose.T_table_camera.is_finite());
  EXPECT_TRUE(pose.covariance.allFinite());
  EXPECT_FALSE(std::isnan(pose.predicted_overlay_error_px));
  if (pose.status != TrackStatus::tracked) return;
  const double error = overlay_difference(session.camera, pose.T_table_camera, truth).rms_px();
  EXPECT_LT(error, 5.0);
  const bool exceeded = error > std::max(1.0, 4.0 * pose.predicted_overlay_error_px);
  if (counts != nullptr) {
    ++counts->tracked;
    counts->exceeded += exceeded ? 1 : 0;
    EXPECT_LT(error, std::max(1.0, 6.0 * pose.predicted_overlay_error_px));
  } else {
    EXPECT_FALSE(exceeded) << error << " px where " << pose.predicted_overlay_error_px
                           << " were predicted";
  }
  EXPECT_LT(pose.predicted_overlay_error_px, 2.0);
}

}  // namespace penumbra::test
