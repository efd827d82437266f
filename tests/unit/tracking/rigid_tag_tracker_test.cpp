#include "tracking/group_tracker.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "support/paths.hpp"
#include "support/random_session.hpp"
#include "support/replay_tracking.hpp"
#include "support/synthetic_view.hpp"
#include "support/test_form.hpp"
#include "tracking/alignment/pattern_renderer.hpp"

namespace penumbra {
namespace {

Frame grey_frame(int width, int height, std::int64_t timestamp_ns) {
  FrameBuffer buffer = allocate_frame(PixelFormat::grey8, width, height);
  for (int y = 0; y < height; ++y) {
    std::uint8_t* row = buffer.plane_data[0] + y * buffer.frame.planes[0].stride;
    std::fill(row, row + width, std::uint8_t{90});
  }
  buffer.frame.timestamp_ns = timestamp_ns;
  return buffer.frame;
}

TEST(RigidTagTracker, RequiresTagOfTableGroup) {
  std::vector<MappedTag> tags = test::sheet();
  for (MappedTag& tag : tags) tag.group = "lid";
  const auto tracker = GroupTracker::create(test::desk_camera(), TagMap::make(tags).value());
  ASSERT_FALSE(tracker);
  EXPECT_THAT(tracker.error().message, testing::HasSubstr("group"));
  TrackerOptions options;
  options.hold_s = std::nan("");
  EXPECT_FALSE(
      GroupTracker::create(test::desk_camera(), TagMap::make(test::sheet()).value(), options));
}

TEST(RigidTagTracker, ReturnsReasonWithoutPose) {
  auto tracker =
      GroupTracker::create(test::desk_camera(), TagMap::make(test::sheet()).value()).value();
  const PoseEstimate nothing = tracker.track(grey_frame(640, 480, 0)).pose;
  EXPECT_EQ(nothing.status, TrackStatus::lost);
  EXPECT_THAT(text_of(nothing.reason), testing::HasSubstr("no tag"));
  const PoseEstimate wrong_size = tracker.track(grey_frame(320, 240, 1)).pose;
  EXPECT_EQ(wrong_size.status, TrackStatus::lost);
  EXPECT_THAT(text_of(wrong_size.reason),
              testing::AllOf(testing::HasSubstr("320x240"), testing::HasSubstr("640x480")));
  EXPECT_EQ(tracker.track(Frame{}).pose.status, TrackStatus::lost);
}

// Fixture with the bundled recording `tabletop`.
class RigidTagTrackerOnTabletop : public testing::Test {
 protected:
  void SetUp() override {
    recording_ = test::recordings_dir() / "tabletop";
    ASSERT_TRUE(std::filesystem::exists(recording_ / "camera.yaml")) << recording_;
    camera_.emplace(load_camera(recording_ / "camera.yaml").value());
    map_.emplace(load_tag_map(recording_ / "tags.yaml").value());
    truth_ = load_trajectory(recording_ / "groundtruth.tum").value();
    listed_ = test::list_frames(recording_).value();
  }
  [[nodiscard]] Frame frame(std::size_t i) const {
    Frame loaded = load_image(listed_[i].file).value();
    loaded.timestamp_ns = listed_[i].timestamp_ns;
    return loaded;
  }
  [[nodiscard]] double error_px(const PoseEstimate& pose, std::int64_t time) const {
    return overlay_difference(*camera_, pose.T_table_camera, truth_.at(time)->T_table_camera)
        .rms_px();
  }
  std::filesystem::path recording_;
  std::optional<CameraModel> camera_;
  std::optional<TagMap> map_;
  Trajectory truth_;
  std::vector<test::ListedFrame> listed_;
};

TEST_F(RigidTagTrackerOnTabletop, ExtrapolatesForHoldTimeThenIsLost) {
  TrackerOptions options;
  options.mode = TrackingMode::detect;
  options.hold_s = 0.25;
  auto tracker = GroupTracker::create(*camera_, *map_, options).value();
  constexpr std::size_t kSeen = 6;
  for (std::size_t i = 0; i < kSeen; ++i) {
    const TrackedFrame tracked = tracker.track(frame(i));
    ASSERT_EQ(tracked.pose.status, TrackStatus::tracked) << text_of(tracked.pose.reason);
    EXPECT_EQ(tracked.pose.reason.cause, PoseCause::none);
    EXPECT_EQ(tracked.pose.age_s, 0.0);
    EXPECT_TRUE(tracked.times.full_detection);
    EXPECT_GT(tracked.times.detect_cpu_ms, 0.0);
    EXPECT_GE(tracked.times.total_cpu_ms, tracked.times.detect_cpu_ms + tracked.times.solve_cpu_ms);
  }
  const std::int64_t last = listed_[kSeen - 1].timestamp_ns;
  const CameraPose last_measured = tracker.track(frame(kSeen)).pose.T_table_camera;
  double previous_error_px = 0.0;
  for (std::size_t i = kSeen + 1; i < kSeen + 7; ++i) {
    const PoseEstimate held = tracker.track(grey_frame(640, 480, listed_[i].timestamp_ns)).pose;
    ASSERT_EQ(held.status, TrackStatus::held);
    EXPECT_NEAR(held.age_s, seconds(listed_[i].timestamp_ns - listed_[kSeen].timestamp_ns), 1e-12);
    EXPECT_THAT(text_of(held.reason), testing::HasSubstr("no tag"));
    EXPECT_GT(held.predicted_overlay_error_px, previous_error_px)
        << "the predicted error must grow";
    previous_error_px = held.predicted_overlay_error_px;
    if (i == kSeen + 2) {
      // The extrapolated pose must be closer to the truth than the most recent measured pose.
      const std::int64_t time = listed_[i].timestamp_ns;
      EXPECT_LT(
          error_px(held, time),
          overlay_difference(*camera_, last_measured, truth_.at(time)->T_table_camera).rms_px());
    }
  }
  const PoseEstimate lost = tracker.track(grey_frame(640, 480, last + 2'000'000'000)).pose;
  EXPECT_EQ(lost.status, TrackStatus::lost);
  // The tags are visible again and must be tracked at once.
  Frame again = frame(20);
  again.timestamp_ns = last + 3'000'000'000;
  EXPECT_EQ(tracker.track(again).pose.status, TrackStatus::tracked);
  // A timestamp that goes back restarts the tracker.
  EXPECT_EQ(tracker.track(frame(3)).pose.status, TrackStatus::tracked);
  EXPECT_EQ(tracker.track(grey_frame(640, 480, 0)).pose.status, TrackStatus::lost);
}

TEST_F(RigidTagTrackerOnTabletop, RejectsMovedTag) {
  std::vector<MappedTag> tags = map_->tags();
  tags[5].T_table_tag = {tags[5].T_table_tag.rotation(),
                         tags[5].T_table_tag.translation() + Eigen::Vector3d(0.015, 0.01, 0.0)};
  auto tracker = GroupTracker::create(*camera_, TagMap::make(tags).value()).value();
  for (std::size_t i = 0; i < 5; ++i) {
    const PoseEstimate pose = tracker.track(frame(i)).pose;
    EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
    EXPECT_EQ(pose.tags_used, 11);
    EXPECT_LT(error_px(pose, listed_[i].timestamp_ns), 0.6);
  }
}

TEST_F(RigidTagTrackerOnTabletop, IgnoresTagsOfOtherGroups) {
  std::vector<MappedTag> tags = map_->tags();
  for (std::size_t i = 0; i < 4; ++i) {
    tags[i].group = "lid";
    tags[i].T_table_tag = {tags[i].T_table_tag.rotation(), Eigen::Vector3d(1.0, 2.0, 3.0)};
  }
  auto tracker = GroupTracker::create(*camera_, TagMap::make(tags).value()).value();
  const PoseEstimate pose = tracker.track(frame(0)).pose;
  EXPECT_EQ(pose.status, TrackStatus::tracked);
  EXPECT_EQ(pose.tags_used, 8);
  EXPECT_LT(error_px(pose, listed_[0].timestamp_ns), 0.6);
}

TEST_F(RigidTagTrackerOnTabletop, ReportsTagsOfAnotherBoard) {
  std::vector<MappedTag> tags = map_->tags();
  for (MappedTag& tag : tags) tag.id += 100;
  auto tracker = GroupTracker::create(*camera_, TagMap::make(tags).value()).value();
  const PoseEstimate pose = tracker.track(frame(0)).pose;
  EXPECT_EQ(pose.status, TrackStatus::lost);
  // At half the resolution one of the twelve tags may not be detected.
  EXPECT_THAT(text_of(pose.reason),
              testing::ContainsRegex("1[12] tags in view, none of them of this board"));
}

TEST_F(RigidTagTrackerOnTabletop, NeverTracksMapThatDoesNotFit) {
  std::vector<MappedTag> tags = map_->tags();
  // Permutes the positions of all tags.
  for (std::size_t i = 0; i < tags.size(); ++i)
    tags[i].T_table_tag = map_->tags()[(i * 7 + 3) % tags.size()].T_table_tag;
  auto tracker = GroupTracker::create(*camera_, TagMap::make(tags).value()).value();
  const PoseEstimate pose = tracker.track(frame(0)).pose;
  EXPECT_NE(pose.status, TrackStatus::tracked);
  EXPECT_NE(pose.reason.cause, PoseCause::none);
}

TEST_F(RigidTagTrackerOnTabletop, DetectsCornersInLinearLightWhenResponseIsKnown) {
  CameraParameters parameters = camera_->parameters();
  parameters.tone_curve = 1.5;
  const CameraModel with_curve = CameraModel::make(parameters).value();
  TrackerOptions options;
  options.mode = TrackingMode::detect;
  auto plain = GroupTracker::create(*camera_, *map_, options).value();
  auto linear = GroupTracker::create(with_curve, *map_, options).value();
  double plain_rms = 0.0;
  double linear_rms = 0.0;
  for (std::size_t i = 0; i < 10; ++i) {
    plain_rms += plain.track(frame(i)).pose.reprojection_rms_px;
    linear_rms += linear.track(frame(i)).pose.reprojection_rms_px;
  }
  EXPECT_LT(linear_rms, 0.8 * plain_rms);
}

// The camera file's uncertainty must add to the predicted error and change no pose.
TEST_F(RigidTagTrackerOnTabletop, AddsLensErrorToPredictedError) {
  const auto with_lens = [&](double sigma_px) {
    CameraParameters parameters = camera_->parameters();
    parameters.overlay_sigma_px = sigma_px;
    return CameraModel::make(parameters).value();
  };
  for (const TrackingMode mode : {TrackingMode::detect, TrackingMode::automatic}) {
    TrackerOptions options;
    options.mode = mode;
    auto plain = GroupTracker::create(*camera_, *map_, options).value();
    auto known = GroupTracker::create(with_lens(0.7), *map_, options).value();
    auto hardly_known = GroupTracker::create(with_lens(3.0), *map_, options).value();
    for (std::size_t i = 0; i < 4; ++i) {
      const PoseEstimate a = plain.track(frame(i)).pose;
      const PoseEstimate b = known.track(frame(i)).pose;
      const PoseEstimate c = hardly_known.track(frame(i)).pose;
      ASSERT_EQ(a.status, TrackStatus::tracked);
      EXPECT_EQ(b.status, TrackStatus::tracked);
      EXPECT_EQ(a.T_table_camera.matrix(), b.T_table_camera.matrix());
      EXPECT_NEAR(b.predicted_overlay_error_px, std::hypot(a.predicted_overlay_error_px, 0.7),
                  1e-12);
      EXPECT_EQ(c.status, TrackStatus::uncertain);
      EXPECT_GT(c.predicted_overlay_error_px, 3.0);
      EXPECT_THAT(text_of(c.reason), testing::HasSubstr("calibrate"));
    }
    const std::int64_t later = listed_[4].timestamp_ns;
    const PoseEstimate a = plain.track(grey_frame(640, 480, later)).pose;
    const PoseEstimate b = known.track(grey_frame(640, 480, later)).pose;
    ASSERT_EQ(b.status, TrackStatus::held);
    EXPECT_NEAR(b.predicted_overlay_error_px, std::hypot(a.predicted_overlay_error_px, 0.7), 1e-12);
    EXPECT_EQ(hardly_known.track(grey_frame(640, 480, later)).pose.status, TrackStatus::held)
        << "an uncertain lens must not end coasting";
  }
}

TEST_F(RigidTagTrackerOnTabletop, IsDeterministic) {
  for (const TrackingMode mode : {TrackingMode::detect, TrackingMode::fast, TrackingMode::accurate,
                                  TrackingMode::automatic}) {
    TrackerOptions options;
    options.mode = mode;
    auto a = GroupTracker::create(*camera_, *map_, options).value();
    auto b = GroupTracker::create(*camera_, *map_, options).value();
    for (std::size_t i = 0; i < 8; ++i) {
      // Frame 3 shows no tags, so that the test includes recovery.
      const Frame shown = i == 3 ? grey_frame(640, 480, listed_[i].timestamp_ns) : frame(i);
      const PoseEstimate x = a.track(shown).pose;
      const PoseEstimate y = b.track(shown).pose;
      EXPECT_EQ(x.status, y.status);
      EXPECT_EQ(x.T_table_camera.matrix(), y.T_table_camera.matrix());
      EXPECT_EQ(x.covariance, y.covariance);
      EXPECT_EQ(x.predicted_overlay_error_px, y.predicted_overlay_error_px);
    }
  }
}

TEST_F(RigidTagTrackerOnTabletop, DetectsOnceThenAligns) {
  for (const TrackingMode mode :
       {TrackingMode::fast, TrackingMode::accurate, TrackingMode::automatic}) {
    TrackerOptions options;
    options.mode = mode;
    auto tracker = GroupTracker::create(*camera_, *map_, options).value();
    for (std::size_t i = 0; i < 10; ++i) {
      const TrackedFrame tracked = tracker.track(frame(i));
      ASSERT_EQ(tracked.pose.status, TrackStatus::tracked) << text_of(tracked.pose.reason);
      EXPECT_EQ(tracked.times.full_detection, i == 0);
      EXPECT_EQ(tracked.times.detect_cpu_ms > 0.0, i == 0);
      EXPECT_GT(tracked.times.align_cpu_ms, 0.0);
      EXPECT_EQ(tracked.pose.tags_used, 12);
      EXPECT_GT(tracked.pose.reprojection_rms_px, 0.0);
      EXPECT_LT(error_px(tracked.pose, listed_[i].timestamp_ns), 0.2);
      if (mode != TrackingMode::automatic) {
        EXPECT_EQ(tracked.times.every_pixel, mode == TrackingMode::accurate);
      }
    }
  }
}

TEST_F(RigidTagTrackerOnTabletop, SamplesEveryPixelInAutomaticModeAtRest) {
  auto tracker = GroupTracker::create(*camera_, *map_).value();
  int moving = 0;
  for (std::size_t i = 0; i < 60; ++i) {
    const TrackedFrame tracked = tracker.track(frame(i));
    ASSERT_EQ(tracked.pose.status, TrackStatus::tracked);
    const double moved_px =
        i == 0 ? 0.0
               : overlay_difference(*camera_, truth_.at(listed_[i].timestamp_ns)->T_table_camera,
                                    truth_.at(listed_[i - 1].timestamp_ns)->T_table_camera)
                     .rms_px();
    if (i > 2 && moved_px > 4.0) {
      EXPECT_FALSE(tracked.times.every_pixel) << moved_px;
      ++moving;
    }
  }
  EXPECT_GT(moving, 10) << "the recording must show motion";
  // Repeats one image, so the motion ends.
  for (std::size_t i = 60; i < 75; ++i) {
    Frame same = frame(59);
    same.timestamp_ns = listed_[i].timestamp_ns;
    const TrackedFrame tracked = tracker.track(same);
    ASSERT_EQ(tracked.pose.status, TrackStatus::tracked);
    if (i > 66) {
      EXPECT_TRUE(tracked.times.every_pixel);
    }
  }
}

TEST_F(RigidTagTrackerOnTabletop, DetectsOncePerFrameWhileLost) {
  auto tracker = GroupTracker::create(*camera_, *map_).value();
  for (std::size_t i = 0; i < 5; ++i)
    ASSERT_EQ(tracker.track(frame(i)).pose.status, TrackStatus::tracked);
  std::int64_t time = listed_[4].timestamp_ns;
  for (int i = 0; i < 30; ++i) {
    time += 33'333'333;
    const TrackedFrame away = tracker.track(grey_frame(640, 480, time));
    EXPECT_TRUE(away.times.full_detection);
    EXPECT_TRUE(away.pose.status == TrackStatus::held || away.pose.status == TrackStatus::lost);
    EXPECT_NE(away.pose.reason.cause, PoseCause::none);
  }
  Frame back = frame(50);
  back.timestamp_ns = time + 33'333'333;
  const TrackedFrame found = tracker.track(back);
  EXPECT_EQ(found.pose.status, TrackStatus::tracked) << text_of(found.pose.reason);
  EXPECT_LT(error_px(found.pose, listed_[50].timestamp_ns), 0.5);
}

// With a known exposure time, motion blur must not displace the estimated pose.
TEST(RigidTagTracker, ModelsBlurWhenExposureIsKnown) {
  double with = 0.0;
  double without = 0.0;
  int frames = 0;
  for (const std::uint64_t seed : {3U, 21U}) {
    test::RandomNumbers draw(seed);
    test::Session session;
    session.camera = test::lens_camera(test::Lens::plumb_bob, 640, 480, 0.85);
    session.tags = test::layout_of(test::Layout::sheet, draw);
    session.motion = test::hand_motion(2, 0.45, radians(50.0), draw);
    session.exposure_s = 1.0 / 40.0;
    session.light.noise_grey = 2.0;
    session.light.seed = seed;
    session.light.samples = 16;
    const TagMap map = TagMap::make(session.tags).value();
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    TrackerOptions options;
    options.mode = TrackingMode::fast;
    auto exposure_known = GroupTracker::create(session.camera, map, options).value();
    auto exposure_unknown = GroupTracker::create(session.camera, map, options).value();
    for (int f = 0; f < 16; ++f) {
      Frame frame = session.image(renderer, f);
      const PoseEstimate a = exposure_unknown.track(frame).pose;
      frame.exposure_s = session.exposure_s;
      const PoseEstimate b = exposure_known.track(frame).pose;
      ASSERT_EQ(b.status, TrackStatus::tracked) << f << ": " << text_of(b.reason);
      if (f < 3 || a.status != TrackStatus::tracked) continue;
      const auto square = [&](const PoseEstimate& pose) {
        const double px =
            overlay_difference(session.camera, pose.T_table_camera, session.truth(f)).rms_px();
        return px * px;
      };
      with += square(b);
      without += square(a);
      ++frames;
    }
  }
  ASSERT_GT(frames, 20);
  EXPECT_LT(std::sqrt(with / frames), 0.8 * std::sqrt(without / frames));
}

// Ceres refines the pose from corners only if no pattern alignment follows.
TEST_F(RigidTagTrackerOnTabletop, SkipsCornerSolveWhenPatternIsAligned) {
  for (std::size_t i = 0; i < listed_.size(); i += 10) {
    SCOPED_TRACE(i);
    const TrackedFrame first = GroupTracker::create(*camera_, *map_)->track(frame(i));
    ASSERT_EQ(first.pose.status, TrackStatus::tracked);
    EXPECT_EQ(first.times.skipped[SkippedWork::corner_solve], 1);
  }
  // Half of the tags are displaced relative to the map, so either half may be right.
  std::vector<MappedTag> tags = map_->tags();
  for (std::size_t i = 0; i < tags.size(); i += 2) {
    tags[i].T_table_tag = {tags[i].T_table_tag.rotation(),
                           tags[i].T_table_tag.translation() + Eigen::Vector3d(0.004, 0.0, 0.0)};
  }
  auto tracker = GroupTracker::create(*camera_, TagMap::make(tags).value()).value();
  const TrackedFrame first = tracker.track(frame(0));
  ASSERT_TRUE(first.pose.has_pose()) << text_of(first.pose.reason);
  EXPECT_NE(first.pose.status, TrackStatus::tracked);
  EXPECT_EQ(first.times.skipped[SkippedWork::corner_solve], 0);
}

TEST_F(RigidTagTrackerOnTabletop, AgreesBetweenDetectionAndAlignmentWithinErrors) {
  TrackerOptions detect_options;
  detect_options.mode = TrackingMode::detect;
  auto detect = GroupTracker::create(*camera_, *map_, detect_options).value();
  auto align = GroupTracker::create(*camera_, *map_).value();
  double ratio2 = 0.0;
  constexpr std::size_t kFrames = 40;
  for (std::size_t i = 0; i < kFrames; ++i) {
    const PoseEstimate a = detect.track(frame(i)).pose;
    const PoseEstimate b = align.track(frame(i)).pose;
    ASSERT_EQ(a.status, TrackStatus::tracked);
    ASSERT_EQ(b.status, TrackStatus::tracked);
    const double between =
        overlay_difference(*camera_, a.T_table_camera, b.T_table_camera).rms_px();
    const double expected = std::hypot(a.predicted_overlay_error_px, b.predicted_overlay_error_px);
    EXPECT_LT(between, 3.0 * expected) << "frame " << i;
    ratio2 += between * between / (expected * expected * kFrames);
  }
  EXPECT_LT(std::sqrt(ratio2), 1.5);
}

// Hand-held motion with a rolling shutter whose readout takes most of the frame interval.
TEST(RigidTagTracker, CorrectsRollingShutter) {
  test::Session session;
  CameraParameters p = test::lens_camera(test::Lens::plumb_bob, 640, 480, 0.85).parameters();
  p.rolling_shutter_row_s = 0.8 * session.frame_s / p.height;
  p.tone_curve = 1.0;
  session.camera = CameraModel::make(p).value();
  session.tags = test::board(3, 2, 0.06);
  session.motion.distance = {0.45, 0.03, 0.9, 0.3};
  session.motion.elevation = {1.0, 0.05, 1.1, 1.0};
  session.motion.azimuth = {0.4, 0.08, 0.8, 2.0};
  session.motion.x = {0.0, 0.03, 1.3, 0.0};
  session.motion.y = {0.0, 0.03, 1.0, 1.5};
  session.light.noise_grey = 2.0;
  session.light.samples = 64;
  p.rolling_shutter_row_s.reset();
  const CameraModel global = CameraModel::make(p).value();
  PatternRenderer renderer = PatternRenderer::create(session.camera, session.tags).value();
  const TagMap map = TagMap::make(session.tags).value();
  TrackerOptions options;
  options.mode = TrackingMode::fast;
  auto knowing = GroupTracker::create(session.camera, map, options).value();
  auto unknowing = GroupTracker::create(global, map, options).value();
  double knowing2 = 0.0;
  double unknowing2 = 0.0;
  constexpr int kFrames = 14;
  constexpr int kFirst = 4;  // from then on the velocity is known
  for (int i = 0; i < kFrames; ++i) {
    const Frame frame = session.image(renderer, i);
    const TrackedFrame with = knowing.track(frame);
    const TrackedFrame without = unknowing.track(frame);
    ASSERT_TRUE(with.pose.has_pose()) << i << ": " << text_of(with.pose.reason);
    EXPECT_LT(
        overlay_difference(session.camera, with.pose.T_table_camera, session.truth(i)).rms_px(),
        3.0 * with.pose.predicted_overlay_error_px)
        << i;
    if (i < kFirst) continue;
    ASSERT_EQ(with.pose.status, TrackStatus::tracked) << i << ": " << text_of(with.pose.reason);
    const auto error2 = [&](const TrackedFrame& tracked) {
      return std::pow(
          overlay_difference(session.camera, tracked.pose.T_table_camera, session.truth(i))
              .rms_px(),
          2);
    };
    knowing2 += error2(with) / (kFrames - kFirst);
    unknowing2 += error2(without) / (kFrames - kFirst);
  }
  RecordProperty("knowing_px", std::to_string(std::sqrt(knowing2)));
  RecordProperty("unknowing_px", std::to_string(std::sqrt(unknowing2)));
  // The remaining error comes from the change of velocity within a frame.
  EXPECT_LT(std::sqrt(knowing2), 0.25);
  EXPECT_GT(std::sqrt(unknowing2), 15.0 * std::sqrt(knowing2));
}

TEST(TrackingMode, HasNames) {
  EXPECT_EQ(value_named(kTrackingModeNames, "detect"), TrackingMode::detect);
  EXPECT_EQ(value_named(kTrackingModeNames, "auto"), TrackingMode::automatic);
  EXPECT_FALSE(value_named(kTrackingModeNames, "automatic"));
}

// One tag, seen from nearly above: two poses explain the image, and the tilt passes through zero.
TEST(RigidTagTracker, TracksSingleTagWithoutMirroredPose) {
  const CameraModel camera = test::desk_camera();
  for (const double size_m : {0.03, 0.08}) {
    const std::vector<MappedTag> tags = {test::flat_tag(3, 0.0, 0.0, size_m)};
    auto renderer = PatternRenderer::create(camera, tags).value();
    int tracked = 0, uncertain = 0;
    int frames = 0;
    // The short form tests the slowest and the fastest path.
    for (int path = 0; path < 3; path += test::nightly() ? 1 : 2) {
      auto tracker = GroupTracker::create(camera, TagMap::make(tags).value()).value();
      for (int i = 0; i < 30; ++i) {
        ++frames;
        const double t = i / 30.0;
        const CameraPose truth =
            test::looking_at_origin(0.6 + 0.05 * std::sin(2.0 * t), 0.2 - (0.1 + 0.2 * path) * t,
                                    0.7 * path + 0.3 * t, 0.2 * t);
        PatternRenderOptions render;
        render.noise_grey = 8.0;
        render.samples = 32;
        render.seed = static_cast<std::uint64_t>(100 * path + i + 1);
        const std::array<CameraPose, 1> poses = {truth};
        const GreyImage image = renderer.render(poses, render);
        FrameBuffer buffer = allocate_frame(PixelFormat::grey8, camera.width(), camera.height());
        for (int y = 0; y < camera.height(); ++y)
          std::copy_n(image.pixels.data() + y * camera.width(), camera.width(),
                      buffer.plane_data[0] + y * buffer.frame.planes[0].stride);
        buffer.frame.timestamp_ns = nanoseconds(t);
        const PoseEstimate pose = tracker.track(buffer.frame).pose;
        if (pose.status != TrackStatus::tracked) {
          EXPECT_NE(pose.reason.cause, PoseCause::none);
          uncertain += pose.status == TrackStatus::uncertain ? 1 : 0;
          continue;
        }
        ++tracked;
        const double error = overlay_difference(camera, pose.T_table_camera, truth).rms_px();
        EXPECT_LT(error, 5.0) << "path " << path << ", frame " << i;
        EXPECT_LT(error, 4.0 * pose.predicted_overlay_error_px);
      }
    }
    EXPECT_GE(tracked, size_m > 0.05 ? frames - frames / 9 : 1) << size_m;
    EXPECT_GE(tracked + uncertain, frames - frames / 18)
        << size_m << ": ambiguous views must be reported";
  }
}

}  // namespace
}  // namespace penumbra
