#include "calib/refinement/residual_watch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "support/hand_held_session.hpp"
#include "support/synthetic_view.hpp"
#include "support/test_form.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

constexpr int kWatchedFrames = 40;

struct Watched {
  std::optional<ResidualCauses> found;
  std::vector<std::string> notices;
  int first_found = -1;      // number of frames until the first cause was found
  int tracked = 0;           // tracked frames after that
  int confident_errors = 0;  // of these, frames with more than 3 times the predicted error
};

// Tracks the session's frames with the given camera and tags.
Watched watch(const test::Session& session, const CameraModel& camera,
              const std::vector<MappedTag>& tags) {
  auto renderer = PatternRenderer::create(session.camera, session.tags).value();
  const TagMap map = TagMap::make(tags).value();
  auto tracker = GroupTracker::create(camera, map).value();
  const auto residuals = ResidualWatch::create(camera, map).value();
  Watched result;
  for (int i = 0; i < kWatchedFrames; ++i) {
    TrackedFrame frame = tracker.track(session.image(renderer, i));
    for (const std::string& notice : residuals->observe(frame)) result.notices.push_back(notice);
    if (residuals->found() && result.first_found < 0) result.first_found = i + 1;
    if (result.first_found >= 0 && frame.pose.status == TrackStatus::tracked) {
      const double error_px =
          overlay_difference(camera, frame.pose.T_table_camera, session.truth(i)).rms_px();
      ++result.tracked;
      result.confident_errors += error_px > 3.0 * frame.pose.predicted_overlay_error_px ? 1 : 0;
    }
  }
  result.found = residuals->found();
  return result;
}

TEST(ResidualWatch, FindsNothingIfMapAndCameraAreRight) {
  for (int seed = 1; seed <= (test::nightly() ? 40 : 2); ++seed) {
    const test::Session session = test::hand_held_session(static_cast<std::uint64_t>(seed));
    const Watched watched = watch(session, session.camera, session.tags);
    EXPECT_FALSE(watched.found) << seed;
    EXPECT_TRUE(watched.notices.empty()) << seed;
  }
}

TEST(ResidualWatch, FindsWrongFocalLengthWithin30Frames) {
  const test::Session session = test::hand_held_session(11);
  CameraParameters wrong = session.camera.parameters();
  wrong.fx *= 1.01;
  wrong.fy *= 1.01;
  const Watched watched = watch(session, CameraModel::make(wrong).value(), session.tags);
  ASSERT_TRUE(watched.found);
  EXPECT_LE(watched.first_found, 30);
  // Displaced tags explain these few frames almost as well.
  EXPECT_TRUE(watched.found->of(ErrorCause::lens).possible);
  EXPECT_FALSE(watched.found->of(ErrorCause::shutter).possible);
  EXPECT_NEAR(watched.found->sizes.focal_fraction, -0.0099, 0.002);
  EXPECT_EQ(watched.confident_errors, 0);
}

TEST(ResidualWatch, FindsCurvedSheetWithin30Frames) {
  const test::Session session = test::hand_held_session(12);
  test::Session of_bent = session;
  of_bent.tags = test::bent_sheet(session.tags);  // the map is flat
  const Watched watched = watch(of_bent, session.camera, session.tags);
  ASSERT_TRUE(watched.found);
  EXPECT_LE(watched.first_found, 30);
  EXPECT_TRUE(watched.found->of(ErrorCause::paper).significant);
  EXPECT_EQ(watched.confident_errors, 0);
  EXPECT_THAT(watched.notices, testing::Contains(testing::HasSubstr("penumbra map")));
  const std::set<std::string> different(watched.notices.begin(), watched.notices.end());
  EXPECT_EQ(different.size(), watched.notices.size()) << "each cause is reported once";
}

TEST(ResidualWatch, FindsRollingShutterWithin30Frames) {
  test::Session session = test::hand_held_session(13);
  CameraParameters rolling = session.camera.parameters();
  rolling.rolling_shutter_row_s = 40e-6;
  const CameraModel global = session.camera;
  session.camera = CameraModel::make(rolling).value();
  const Watched watched = watch(session, global, session.tags);
  ASSERT_TRUE(watched.found);
  EXPECT_LE(watched.first_found, 30);
  EXPECT_TRUE(watched.found->of(ErrorCause::shutter).significant);
  EXPECT_NEAR(watched.found->sizes.row_time_s, 40e-6, 4e-6);
  EXPECT_EQ(watched.confident_errors, 0);
}

TEST(ResidualWatch, IgnoresFramesWithoutPoseAndNonFiniteNumbers) {
  const test::Session session = test::hand_held_session(14);
  const TagMap map = TagMap::make(session.tags).value();
  const auto residuals = ResidualWatch::create(session.camera, map).value();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  FrameBuffer grey = allocate_frame(PixelFormat::grey8, 640, 480);
  for (int i = 0; i < 20; ++i) {
    TrackedFrame frame;
    frame.frame = grey.frame;
    frame.frame.timestamp_ns = i % 3 == 0 ? 0 : i;
    frame.pose.status = i % 2 == 0 ? TrackStatus::tracked : TrackStatus::lost;
    frame.pose.tags_used = i % 4;
    frame.pose.predicted_overlay_error_px = nan;
    EXPECT_TRUE(residuals->observe(frame).empty());
    EXPECT_FALSE(residuals->found());
  }
}

TEST(ResidualWatch, MeasuresPartOfManyTags) {
  std::vector<MappedTag> tags;
  for (int i = 0; i < 160; ++i)
    tags.push_back(test::flat_tag(i, 0.03 * (i % 16), 0.03 * (i / 16), 0.02));
  const test::Session session = test::hand_held_session(15);
  EXPECT_TRUE(ResidualWatch::create(session.camera, TagMap::make(tags).value()));
}

// Two tags fit any camera, so their residuals show nothing.
TEST(ResidualWatch, TestsNothingWithFewerThanThreeTags) {
  test::Session session = test::hand_held_session(15);
  session.tags.resize(2);
  CameraParameters wrong = session.camera.parameters();
  wrong.fx *= 1.02;
  wrong.fy *= 1.02;
  EXPECT_FALSE(watch(session, CameraModel::make(wrong).value(), session.tags).found);
}

TEST(ResidualWatch, ForgetsCausesOfPreviousMap) {
  const test::Session flat = test::hand_held_session(12);
  test::Session session = flat;
  session.tags = test::bent_sheet(flat.tags);
  auto renderer = PatternRenderer::create(session.camera, session.tags).value();
  const TagMap wrong = TagMap::make(flat.tags).value();
  const TagMap right = TagMap::make(session.tags).value();
  auto tracker = GroupTracker::create(session.camera, wrong).value();
  const auto residuals = ResidualWatch::create(session.camera, wrong).value();
  int frame = 0;
  for (; frame < kWatchedFrames && !residuals->found(); ++frame) {
    TrackedFrame tracked = tracker.track(session.image(renderer, frame));
    std::ignore = residuals->observe(tracked);
  }
  ASSERT_TRUE(residuals->found());
  ASSERT_TRUE(tracker.set_map(session.camera, right));
  ASSERT_TRUE(residuals->restart(session.camera, right));
  EXPECT_FALSE(residuals->found());
  for (int i = 0; i < kWatchedFrames; ++i, ++frame) {
    TrackedFrame tracked = tracker.track(session.image(renderer, frame));
    EXPECT_TRUE(residuals->observe(tracked).empty()) << i;
    EXPECT_EQ(tracked.pose.status, TrackStatus::tracked) << i;
    EXPECT_NE(tracked.pose.reason.cause, PoseCause::systematic_error) << i;
  }
  EXPECT_FALSE(residuals->found());
}

}  // namespace
}  // namespace penumbra
