// Poses of whole recordings, compared with their exact truth. No frame with the status `tracked`
// may be wrong.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "support/paths.hpp"
#include "support/replay_tracking.hpp"
#include "support/test_form.hpp"
#include "support/tracking_mode_name.hpp"
#include "support/visibility.hpp"

namespace penumbra {
namespace {

struct Expected {
  std::string name;
  bool bundled = false;
  int min_tracked = 0;     // minimum number of tracked frames
  double median_px = 0.0;  // median over all corners of tracked frames
  double max_px = 0.0;     // maximum RMS over the corners of a tracked frame
  int max_detections = 0;
  TrackingMode mode = TrackingMode::automatic;
};

// Limits are measured values plus a margin for rounding on other machines. A tracked frame must
// never reach 5 px. The short form tracks the first rows: all recordings in the automatic mode, and
// one recording in each other mode.
constexpr std::ptrdiff_t kShortForm = 11;
const std::vector<Expected>& expectations() {
  constexpr auto kDetect = TrackingMode::detect;
  constexpr auto kFast = TrackingMode::fast;
  constexpr auto kAccurate = TrackingMode::accurate;
  static const std::vector<Expected> all = {
      {"tabletop", true, 120, 0.06, 0.3, 1},
      {"corner", true, 40, 0.06, 0.3, 1},
      {"corner", false, 90, 0.06, 0.3, 1},
      {"still", false, 50, 0.04, 0.2, 1},
      {"reentry", false, 58, 0.08, 1.0, 38},
      {"single", false, 88, 0.4, 4.0, 3},
      {"shake", false, 84, 0.4, 2.5, 6},
      {"grazing", false, 90, 0.06, 0.3, 1},
      {"shake", false, 83, 0.4, 2.5, 8, kFast},
      {"reentry", false, 58, 0.08, 1.0, 38, kAccurate},
      {"grazing", false, 70, 1.5, 5.0, 90, kDetect},
      {"tabletop", true, 120, 0.06, 0.3, 1, kFast},
      {"still", false, 50, 0.08, 0.3, 1, kFast},
      {"grazing", false, 90, 0.06, 0.3, 1, kFast},
      {"reentry", false, 58, 0.08, 1.0, 38, kFast},
      {"single", false, 88, 0.4, 4.0, 3, kFast},
      {"tabletop", true, 120, 0.05, 0.2, 1, kAccurate},
      {"still", false, 50, 0.04, 0.2, 1, kAccurate},
      {"grazing", false, 90, 0.06, 0.3, 1, kAccurate},
      {"single", false, 88, 0.4, 4.0, 3, kAccurate},
      {"shake", false, 82, 0.4, 3.0, 8, kAccurate},
      {"tabletop", true, 120, 0.5, 2.0, 120, kDetect},
      {"corner", false, 90, 0.5, 2.0, 90, kDetect},
      {"still", false, 50, 0.5, 2.0, 50, kDetect},
      {"reentry", false, 56, 0.5, 5.0, 90, kDetect},
      {"single", false, 36, 1.5, 5.0, 90, kDetect},
      {"shake", false, 40, 1.5, 5.0, 90, kDetect},
  };
  static const std::vector<Expected> list(all.begin(),
                                          test::nightly() ? all.end() : all.begin() + kShortForm);
  return list;
}

class TrackedRecordings : public testing::TestWithParam<Expected> {};
INSTANTIATE_TEST_SUITE_P(Tracking, TrackedRecordings, testing::ValuesIn(expectations()),
                         [](const testing::TestParamInfo<Expected>& test) {
                           return test.param.name +
                                  (test.param.bundled ? "_bundled_" : "_shared_") +
                                  std::string(to_string(test.param.mode));
                         });

TEST_P(TrackedRecordings, StayWithinErrorBounds) {
  const Expected& expected = GetParam();
  const std::filesystem::path shared = test::shared_dir();
  if (!expected.bundled && shared.empty())
    GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::filesystem::path folder =
      (expected.bundled ? test::recordings_dir() : shared / "recordings") / expected.name;
  TrackerOptions options;
  options.mode = expected.mode;
  const auto result = test::track_recording(folder, options);
  ASSERT_TRUE(result) << result.error().message;
  for (std::size_t i = 0; i < result->frames.size(); ++i) {
    const PoseEstimate& pose = result->frames[i].pose;
    if (pose.status == TrackStatus::tracked) {
      EXPECT_GE(result->overlay_px[i], 0.0) << "frame " << i << " has no truth";
      EXPECT_LT(result->overlay_px[i], expected.max_px) << "frame " << i;
      EXPECT_EQ(pose.reason.cause, PoseCause::none);
    } else {
      EXPECT_NE(pose.reason.cause, PoseCause::none) << "frame " << i;
    }
  }
  int detections = 0;
  for (const TrackedFrame& frame : result->frames) detections += frame.times.full_detection ? 1 : 0;
  EXPECT_LE(detections, expected.max_detections);
  EXPECT_EQ(result->wrong, 0);
  EXPECT_GE(result->count_of(TrackStatus::tracked), expected.min_tracked);
  EXPECT_LE(result->tracked.overlay_px.median, expected.median_px);
}

// Compares the frame-to-frame change of the overlay for a camera at rest with that of detection.
TEST(StillRecording, HasLessJitterThanDetection) {
  const std::filesystem::path shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const auto jitter_px = [&](TrackingMode mode) {
    TrackerOptions options;
    options.mode = mode;
    const auto result = test::track_recording(shared / "recordings" / "still", options).value();
    EXPECT_GT(result.tracked.jitter_changes, 40);
    return result.tracked.jitter_px;
  };
  const double detected = jitter_px(TrackingMode::detect);
  EXPECT_LT(jitter_px(TrackingMode::automatic), 0.45 * detected);
  EXPECT_LT(jitter_px(TrackingMode::accurate), 0.45 * detected);
  EXPECT_LT(jitter_px(TrackingMode::fast), 0.75 * detected);
}

// The map displaces one of five tags, in a grazing view. The nightly form tests four displacements
// for each tag and axis, the short form one.
TEST(GrazingRecording, KeepsPoseWhenOneTagMoved) {
  const std::filesystem::path shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const auto session = test::load_session(shared / "recordings" / "grazing");
  ASSERT_TRUE(session) << session.error().message;
  std::vector<Frame> frames;
  for (const test::ListedFrame& entry : session->listed) {
    frames.push_back(test::load_frame_image(entry).value());
  }
  const std::vector<MappedTag> tags(session->tags.tags().begin(), session->tags.tags().end());
  for (std::size_t k = 0; k < tags.size(); ++k) {
    for (const int axis : {0, 1}) {
      constexpr std::array kBy_m = {0.003, 0.005, 0.01, -0.005};
      for (std::size_t move = 0; move < kBy_m.size(); ++move) {
        if (!test::nightly() && move != (k + 2 * static_cast<std::size_t>(axis)) % kBy_m.size())
          continue;
        const double by_m = kBy_m[move];
        SCOPED_TRACE(testing::Message() << "tag " << tags[k].id << " by " << by_m << " m along "
                                        << "xy"[axis]);
        std::vector<MappedTag> wrong = tags;
        const auto& T = tags[k].T_table_tag;
        wrong[k].T_table_tag = {
            T.rotation(), Eigen::Vector3d(T.translation() + by_m * Eigen::Vector3d::Unit(axis))};
        auto trial = test::TrackingTrial::create(*session, TagMap::make(wrong).value());
        ASSERT_TRUE(trial) << trial.error().message;
        for (const Frame& frame : frames) trial->add(frame);
        const test::TrackedRecording result = trial->result();
        EXPECT_GE(result.count_of(TrackStatus::tracked), 80);
        for (std::size_t i = 0; i < result.frames.size(); ++i) {
          const PoseEstimate& pose = result.frames[i].pose;
          if (pose.status == TrackStatus::tracked) {
            EXPECT_LT(result.overlay_px[i], 1.0) << "frame " << i;
          }
        }
      }
    }
  }
}

// Tracks only every third frame of a shaken camera. The pattern search must recover most frames
// without a detection.
TEST(ShakeRecording, RecoversByPatternSearchAfterJumps) {
  const std::filesystem::path shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::filesystem::path folder = shared / "recordings" / "shake";
  const auto result = test::track_recording(folder, {}, 3);
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(result->wrong, 0);
  EXPECT_GE(result->count_of(TrackStatus::tracked), 26);  // 27 measured; three are too blurred
  ASSERT_EQ(result->overlay_px.size(), 30U);
  int measured = 0;
  for (std::size_t i = 0; i < result->overlay_px.size(); ++i) {
    const TrackStatus status = result->frames[i].pose.status;
    if (status != TrackStatus::tracked && status != TrackStatus::uncertain) continue;
    ++measured;
    EXPECT_LT(result->overlay_px[i], 2.5) << i;  // 1.3 measured
  }
  EXPECT_GE(measured, 30);
  int found_by_pattern = 0;
  int detected = 0;
  for (const TrackedFrame& frame : result->frames) {
    found_by_pattern += frame.times.pyramid_search ? 1 : 0;
    detected += frame.times.full_detection || frame.times.roi_detection ? 1 : 0;
  }
  EXPECT_GE(found_by_pattern, 4);
  EXPECT_LE(detected, found_by_pattern);
}

// The board leaves the view and returns.
TEST(ReentryRecording, ReportsNoPoseWhileBoardIsAwayAndRecoversAtOnce) {
  const std::filesystem::path shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::filesystem::path folder = shared / "recordings" / "reentry";
  const auto result = test::track_recording(folder);
  ASSERT_TRUE(result) << result.error().message;
  const std::vector<int> corners = test::max_corners_in_view(folder, result->frames.size());
  ASSERT_EQ(corners.size(), result->frames.size());
  int away = 0;
  std::size_t back = 0;  // first frame after the return
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const TrackStatus status = result->frames[i].pose.status;
    if (corners[i] == 0) {
      ++away;
      EXPECT_NE(status, TrackStatus::tracked) << "frame " << i;
      EXPECT_NE(status, TrackStatus::uncertain) << "frame " << i;
    }
    if (i > 0 && corners[i] == 4 && corners[i - 1] < 4) back = i;
  }
  EXPECT_GT(away, 20);
  ASSERT_GT(back, 0U);
  const auto first = std::find_if(
      result->frames.begin() + static_cast<std::ptrdiff_t>(back), result->frames.end(),
      [](const TrackedFrame& frame) { return frame.pose.status == TrackStatus::tracked; });
  EXPECT_LE(first - result->frames.begin(), static_cast<std::ptrdiff_t>(back) + 3);
}

}  // namespace
}  // namespace penumbra
