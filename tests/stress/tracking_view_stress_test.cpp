// Views that change during tracking: exposure jumps, tags that enter the view, the limits of
// visibility, tags at a fisheye lens's rim, and duplicate prints.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "support/random_session.hpp"
#include "support/test_form.hpp"
#include "support/tracked_session.hpp"
#include "support/tracking_mode_name.hpp"
#include "tracking/group_tracker.hpp"
#include "tracking/pose_confidence.hpp"

namespace penumbra {
namespace {

using test::easy_session;
using test::expect_consistent;
using test::Layout;
using test::Lens;
using test::nightly;
using test::RandomNumbers;
using test::Session;

GroupTracker tracker_of(const Session& session, TrackingMode mode = TrackingMode::automatic) {
  TrackerOptions options;
  options.mode = mode;
  return GroupTracker::create(session.camera, TagMap::make(session.tags).value(), options).value();
}

double error_px(const Session& session, const PoseEstimate& pose, int frame) {
  return overlay_difference(session.camera, pose.T_table_camera, session.truth(frame)).rms_px();
}

// Between frames, the exposure or a lamp changes the brightness by a factor of up to 10, while the
// camera moves.
TEST(TrackingStress, TracksThroughExposureJumps) {
  constexpr std::array<double, 12> kGains = {1.0, 0.3, 1.0,  0.15, 1.2, 0.12,
                                             1.2, 2.5, 0.25, 0.25, 1.0, 0.1};
  for (const TrackingMode mode : {TrackingMode::fast, TrackingMode::automatic}) {
    for (const double noise : {0.5, 2.0}) {
      SCOPED_TRACE(testing::Message() << to_string(mode) << ", noise " << noise);
      Session session = easy_session();
      session.light.noise_grey = noise;
      auto renderer = PatternRenderer::create(session.camera, session.tags).value();
      GroupTracker tracker = tracker_of(session, mode);
      for (std::size_t f = 0; f < kGains.size(); ++f) {
        SCOPED_TRACE(f);
        session.light.gain = kGains[f];
        const auto number = static_cast<int>(f);
        const TrackedFrame frame = tracker.track(session.image(renderer, number));
        EXPECT_EQ(frame.pose.status, TrackStatus::tracked) << text_of(frame.pose.reason);
        EXPECT_EQ(frame.pose.tags_used, 12);
        EXPECT_EQ(frame.times.full_detection, f == 0);
        EXPECT_FALSE(frame.times.roi_detection);
        expect_consistent(session, frame.pose, session.truth(number));
        EXPECT_LT(error_px(session, frame.pose, number), 0.5);
      }
    }
  }
}

struct TagsInView {
  int inside = 0;   // tags with all corners at least `margin_px` inside the image
  int outside = 0;  // tags with all corners at least `margin_px` outside the image
};
TagsInView tags_in_view(const Session& session, const CameraPose& at, double margin_px) {
  TagsInView in_view;
  const Eigen::Vector2d last(session.camera.width() - 1, session.camera.height() - 1);
  for (const MappedTag& tag : session.tags) {
    double inside = 1e9;
    double outside = 1e9;
    for (const Eigen::Vector3d& corner : tag.corners()) {
      const auto p = session.camera.project(at.inverse() * corner);
      if (!p) return {};
      const double depth = std::min(p->minCoeff(), (last - *p).minCoeff());
      inside = std::min(inside, depth);
      outside = std::min(outside, -depth);
    }
    in_view.inside += inside >= margin_px ? 1 : 0;
    in_view.outside += outside >= margin_px ? 1 : 0;
  }
  return in_view;
}

// The camera moves from a corner of the sheet to the whole sheet and back. Each tag must be used as
// soon as it is visible, without a search.
TEST(TrackingStress, AddsTagsAsTheyEnterView) {
  for (const TrackingMode mode : {TrackingMode::fast, TrackingMode::accurate}) {
    SCOPED_TRACE(to_string(mode));
    Session session = easy_session();
    session.motion.azimuth.middle = radians(-90.0);
    session.motion.roll.middle = 0.0;
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    GroupTracker tracker = tracker_of(session, mode);
    int fewest = 12;
    int max_tags_used = 0;
    int out = 0;
    const int frames = nightly() ? 60 : 30;
    for (int f = 0; f < frames; ++f) {
      SCOPED_TRACE(f);
      const double away = 0.5 + 0.5 * std::cos(2.0 * std::numbers::pi * f / frames);
      Session now = session;
      now.motion.x.middle = 0.24 * away;
      now.motion.y.middle = 0.10 * away;
      const TrackedFrame frame = tracker.track(now.image(renderer, f));
      EXPECT_EQ(frame.pose.status, TrackStatus::tracked) << text_of(frame.pose.reason);
      EXPECT_EQ(frame.times.full_detection, f == 0);
      expect_consistent(now, frame.pose, now.truth(f));
      const TagsInView in_view = tags_in_view(now, now.truth(f), 4.0);
      EXPECT_GE(frame.pose.tags_used, in_view.inside);
      const int far_out = tags_in_view(now, now.truth(f), 40.0).outside;
      EXPECT_GE(frame.times.skipped[SkippedWork::out_of_view], far_out);
      EXPECT_LE(frame.times.skipped[SkippedWork::out_of_view], 12 - in_view.inside);
      out = std::max(out, far_out);
      fewest = std::min(fewest, in_view.inside);
      max_tags_used = std::max(max_tags_used, frame.pose.tags_used);
    }
    EXPECT_LE(fewest, 6);
    EXPECT_GE(out, 1);
    EXPECT_EQ(max_tags_used, 12);
  }
}

// A strong fisheye lens sees the sheet at its rim, where the last coefficients displace corners by
// pixels.
TEST(TrackingStress, TracksAtFisheyeRimAsWellAsAtCentre) {
  for (const double focal : {0.35, 0.45}) {
    for (const double aside : {0.0, 0.25, 0.4}) {
      SCOPED_TRACE(testing::Message() << "focal " << focal << ", aside " << aside);
      Session session = easy_session();
      session.camera = test::lens_camera(Lens::fisheye, 960, 720, focal);
      session.tags = test::board(4, 3, 0.09);
      session.light.samples = 128;
      session.motion.distance.middle = 0.45;
      session.motion.elevation.middle = radians(75.0);
      session.motion.x.middle = aside;
      session.motion.y.middle = 0.7 * aside;
      auto renderer = PatternRenderer::create(session.camera, session.tags).value();
      GroupTracker tracker = tracker_of(session);
      for (int f = 0; f < (nightly() ? 20 : 2); ++f) {
        SCOPED_TRACE(f);
        const CameraPose truth = session.truth(f);
        const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
        EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
        expect_consistent(session, pose, truth);
        const double corners_px =
            test::corner_distance_px(session.camera, session.tags, pose.T_table_camera, truth);
        EXPECT_LT(corners_px, 0.1);
      }
    }
  }
}

// A table that is a hundred times larger at a hundred times the distance gives the same image, and
// the pose must scale.
TEST(TrackingStress, ScalesPoseWithTableSize) {
  for (const double times : {0.1, 100.0}) {
    SCOPED_TRACE(times);
    Session session = easy_session();
    for (MappedTag& tag : session.tags) {
      tag.size_m *= times;
      tag.T_table_tag = {tag.T_table_tag.rotation(), times * tag.T_table_tag.translation()};
    }
    for (test::Oscillation* sway :
         {&session.motion.distance, &session.motion.x, &session.motion.y}) {
      sway->middle *= times;
      sway->amplitude *= times;
    }
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    GroupTracker tracker = tracker_of(session);
    for (int f = 0; f < 5; ++f) {
      SCOPED_TRACE(f);
      const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
      const CameraPose truth = session.truth(f);
      ASSERT_TRUE(pose.has_pose()) << text_of(pose.reason);
      // The overlay's cube is always 0.2 m. At a distance of a few centimetres, its error does not
      // measure the pose.
      if (times > 1.0) {
        EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
        expect_consistent(session, pose, truth);
      }
      const double distance = truth.translation().norm();
      EXPECT_LT((pose.T_table_camera.translation() - truth.translation()).norm(), 1e-3 * distance);
      EXPECT_LT(degrees(pose.T_table_camera.rotation().angularDistance(truth.rotation())), 0.1);
      EXPECT_LT(test::corner_distance_px(session.camera, session.tags, pose.T_table_camera, truth),
                0.1);
    }
  }
}

// Tags that recede are lost when they are too small. The status must report that.
TEST(TrackingStress, LosesTagsTooFarAway) {
  Session session = easy_session();
  auto renderer = PatternRenderer::create(session.camera, session.tags).value();
  GroupTracker tracker = tracker_of(session);
  constexpr int kFrames = 60;
  for (int f = 0; f < kFrames; ++f) {
    SCOPED_TRACE(f);
    Session now = session;
    now.motion.distance.middle *= std::pow(1.06, f);
    const PoseEstimate pose = tracker.track(now.image(renderer, f)).pose;
    expect_consistent(now, pose, now.truth(f));
    if (pose.status != TrackStatus::tracked) {
      EXPECT_NE(pose.reason.cause, PoseCause::none);
    }
    if (f < 20) {  // tags are 12 px wide
      EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
    }
    if (f == kFrames - 1) {  // tags are 1 px wide
      EXPECT_EQ(pose.status, TrackStatus::lost);
    }
  }
}

// One condition degrades step by step from easy to invisible. The pose must be tracked up to the
// given limit, and beyond it no wrong pose may be tracked.
TEST(TrackingStress, TracksDegradingConditionsToExpectedLimits) {
  struct Condition {
    const char* name;
    double from, to, tracked_to;
    bool inverse;
    std::function<void(Session&, double)> set;
  };
  const std::vector<Condition> conditions = {
      {"side px", 25.0, 8.0, 10.0, true,
       [](Session& s, double v) {
         RandomNumbers draw(3);
         s.tags = test::layout_of(Layout::one, draw);
         s.motion.distance.middle = s.camera.parameters().fx * s.tags.front().size_m / v;
         s.motion.elevation.middle = radians(50.0);
         s.motion.x.middle = s.tags.front().T_table_tag.translation().x();
         s.motion.y.middle = s.tags.front().T_table_tag.translation().y();
       }},
      {"tilt deg", 60.0, 85.0, 81.0, false,
       [](Session& s, double v) { s.motion.elevation.middle = radians(90.0 - v); }},
      {"cover", 0.0, 0.8, 0.5, false, [](Session& s, double v) { s.light.covered_fraction = v; }},
      {"noise", 2.0, 60.0, 25.0, false, [](Session& s, double v) { s.light.noise_grey = v; }},
      {"light", 1.0, 0.01, 0.05, true,
       [](Session& s, double v) {
         s.light.gain = v;
         s.light.noise_grey = 1.0;
       }},
  };
  for (const Condition& condition : conditions) {
    SCOPED_TRACE(condition.name);
    Session first = easy_session();
    condition.set(first, condition.from);
    auto renderer = PatternRenderer::create(first.camera, first.tags).value();
    GroupTracker tracker = tracker_of(first);
    const int steps = nightly() ? 60 : 20;
    double reached = condition.from;
    for (int f = 0; f <= steps; ++f) {
      // With `inverse`, the reciprocal changes linearly. The reciprocal of a tag's size in the
      // image is proportional to its distance.
      const double fraction = static_cast<double>(f) / steps;
      const double value = condition.inverse
                               ? 1.0 / (1.0 / condition.from +
                                        (1.0 / condition.to - 1.0 / condition.from) * fraction)
                               : condition.from + (condition.to - condition.from) * fraction;
      SCOPED_TRACE(value);
      Session now = easy_session();
      condition.set(now, value);
      const PoseEstimate pose = tracker.track(now.image(renderer, f)).pose;
      expect_consistent(now, pose, now.truth(f));
      if (pose.status != TrackStatus::tracked) {
        EXPECT_NE(pose.reason.cause, PoseCause::none);
      }
      const bool expected = (value - condition.tracked_to) * (condition.to - condition.from) <= 0.0;
      if (pose.status == TrackStatus::tracked) reached = value;
      if (expected) {
        EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
      }
    }
    RecordProperty(condition.name, fmt::format("tracked to {:.3g}", reached));
  }
}

// Returns the width of the first tag in the image, perpendicular to its longer sides [px].
double min_width_px(const Session& session, const CameraPose& at) {
  std::vector<Eigen::Vector2d> corners;
  for (const Eigen::Vector3d& corner : session.tags.front().corners())
    corners.push_back(session.camera.project(at.inverse() * corner).value());
  const Eigen::Vector2d a = corners[1] - corners[0];
  const Eigen::Vector2d b = corners[3] - corners[0];
  return std::abs(a.x() * b.y() - a.y() * b.x()) / std::max(a.norm(), b.norm());
}

// A single tag recedes until it is seven pixels wide, and returns. At that size its second pose
// explains the image as well as the true one, and model errors may favour it. The tracker must keep
// the true pose.
TEST(TrackingStress, KeepsCorrectPoseOfRecedingSingleTag) {
  int tracked = 0;
  int frames = 0;
  int tracked_readable = 0;
  int readable = 0;  // frames on the way out in which a cell is at least one pixel wide
  const int sessions = nightly() ? 40 : 1;
  for (int k = 0; k < sessions; ++k) {
    RandomNumbers draw(60U + static_cast<std::uint64_t>(k));
    Session session = easy_session();
    session.tags = test::layout_of(Layout::one, draw);
    session.light.noise_grey = draw.between(0.0, 5.0);
    session.light.lens_blur_px = draw.between(0.4, 0.7);
    session.light.seed = static_cast<std::uint64_t>(k) + 1;
    session.motion.elevation.middle = radians(draw.between(30.0, 65.0));
    const Eigen::Vector3d place = session.tags.front().T_table_tag.translation();
    session.motion.x.middle = place.x();
    session.motion.y.middle = place.y();
    const double distance_times_px = session.camera.parameters().fx * session.tags.front().size_m;
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    GroupTracker tracker = tracker_of(session);
    constexpr int kFrames = 160;
    for (int f = 0; f < kFrames; ++f) {
      SCOPED_TRACE(testing::Message() << "session " << k << ", frame " << f);
      const double away = 0.5 - 0.5 * std::cos(2.0 * std::numbers::pi * f / kFrames);
      Session now = session;
      now.motion.distance.middle = distance_times_px * (away / 7.0 + (1.0 - away) / 30.0);
      const PoseEstimate pose = tracker.track(now.image(renderer, f)).pose;
      expect_consistent(now, pose, now.truth(f));
      const bool is_tracked = pose.status == TrackStatus::tracked;
      tracked += is_tracked ? 1 : 0;
      ++frames;
      // On the way back, the pose may be ambiguous after a new detection.
      if (2 * f > kFrames || min_width_px(now, now.truth(f)) < 8.0) continue;
      tracked_readable += is_tracked ? 1 : 0;
      ++readable;
    }
  }
  RecordProperty("tracked", fmt::format("{} of {}", tracked, frames));
  RecordProperty("readable", fmt::format("{} of {}", tracked_readable, readable));
  EXPECT_GT(5 * readable, frames);
  EXPECT_GE(tracked_readable, 0.97 * readable) << "of " << readable;
}

// A single tag in the first frame, with any lens, camera response, light and tilt. Its pose may
// have the status tracked only if the image determines it.
TEST(TrackingStress, TracksFirstPoseOfSingleTagOnlyWhenUnambiguous) {
  int tracked = 0;
  int ambiguous = 0;
  int wrong = 0;
  const int sessions = nightly() ? 3000 : 30;
  for (int k = 0; k < sessions; ++k) {
    SCOPED_TRACE(k);
    test::SessionKind kind;
    Session session = test::random_session(70'000U + static_cast<std::uint64_t>(k), kind);
    RandomNumbers draw(80U + static_cast<std::uint64_t>(k));
    session.tags = test::layout_of(Layout::one, draw);
    session.light.samples = 64;
    const double fx = session.camera.parameters().fx;
    session.motion.distance.middle =
        std::max(0.34, fx * session.tags.front().size_m / draw.log_between(10.0, 60.0));
    const Eigen::Vector3d place = session.tags.front().T_table_tag.translation();
    session.motion.x.middle = place.x();
    session.motion.y.middle = place.y();
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    const PoseEstimate pose = tracker_of(session).track(session.image(renderer, 0)).pose;
    ambiguous +=
        pose.status == TrackStatus::uncertain && pose.reason.cause == PoseCause::two_poses ? 1 : 0;
    if (pose.status != TrackStatus::tracked) continue;
    ++tracked;
    wrong += error_px(session, pose, 0) > 5.0 ? 1 : 0;
  }
  RecordProperty("first", fmt::format("{} tracked, {} of them wrong, {} open, of {}", tracked,
                                      wrong, ambiguous, sessions));
  EXPECT_GE(tracked, 0.4 * sessions);
  EXPECT_GT(ambiguous, 0);
  EXPECT_LE(wrong, 0.002 * tracked);
}

// Duplicate prints of tags must be rejected if other tags determine which print is right, also in
// the mode `detect`. Without such tags, no pose may be tracked.
TEST(TrackingStress, RejectsDuplicatePrintsOfTags) {
  const auto with_copies = [](const Session& session, std::size_t count) {
    std::vector<MappedTag> drawn = session.tags;
    for (std::size_t k = 0; k < count; ++k) {
      MappedTag copy = session.tags[k];
      copy.T_table_tag = {copy.T_table_tag.rotation(),
                          copy.T_table_tag.translation() + Eigen::Vector3d(0.0, 0.17, 0.0)};
      drawn.push_back(copy);
    }
    return drawn;
  };
  for (const TrackingMode mode : {TrackingMode::automatic, TrackingMode::detect}) {
    for (const bool few : {false, true}) {
      for (const bool all : {false, true}) {
        SCOPED_TRACE(fmt::format("{}, {}, {}", to_string(mode), few ? "few" : "many",
                                 all ? "all twice" : "one twice"));
        Session session = easy_session();
        if (few) session.tags = test::board(2, 1, 0.06);
        session.motion.distance.middle = 0.7;
        const auto drawn = with_copies(session, all ? session.tags.size() : 1);
        auto renderer = PatternRenderer::create(session.camera, drawn).value();
        GroupTracker tracker = tracker_of(session, mode);
        for (int f = 0; f < 3; ++f) {
          SCOPED_TRACE(f);
          const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
          if (all) {
            EXPECT_NE(pose.status, TrackStatus::tracked);
            EXPECT_NE(pose.reason.cause, PoseCause::none);
            continue;
          }
          expect_consistent(session, pose, session.truth(f));
          if (!few) {
            EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
            // Detection can't distinguish the prints; alignment keeps the right one.
            EXPECT_EQ(pose.tags_used, mode == TrackingMode::detect ? 11 : 12);
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace penumbra
