// Tracks the table and other rigid tag groups in one image. Each group moves independently, and its
// true pose is exact.
#include "tracking/group_tracker.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <thread>

#include "core/evaluation/evaluation.hpp"
#include "support/group_stage.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace group_tracker_test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

using test::block;
using test::group_named;
using test::Placement;
using test::Placements;
using test::shifted;
using test::Stage;
using test::turned;
using test::wall;

TEST(GroupTracker, ListsGroupsOfMapInOrder) {
  const Stage stage({block(), wall()});
  EXPECT_THAT(other_groups(stage.map()), ElementsAre("block", "wall"));
  const auto middle = middle_of_group(stage.map(), "wall");
  EXPECT_NEAR((middle.translation() - Eigen::Vector3d(0.0, 0.14, 0.085)).norm(), 0.0, 1e-12);
  EXPECT_NEAR((middle.rotation() * Eigen::Vector3d::UnitZ() + Eigen::Vector3d::UnitY()).norm(), 0.0,
              1e-12);
  const TrackedFrame tracked = stage.tracker().track(stage.frame_image(0));
  ASSERT_EQ(tracked.groups.size(), 2U);
  EXPECT_EQ(tracked.groups[0].name, "block");
  EXPECT_EQ(tracked.groups[1].name, "wall");
}

TEST(GroupTracker, RejectsMapWithoutTableOrWithUnknownTag) {
  const auto no_table =
      GroupTracker::create(Stage({}).camera, TagMap::make(wall()).value(), TrackerOptions());
  ASSERT_FALSE(no_table);
  EXPECT_THAT(no_table.error().message, HasSubstr("'table'"));
  Stage stage({wall()});
  stage.tags.back().id = 9999;
  const auto unknown = GroupTracker::create(stage.camera, stage.map());
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().message, testing::AllOf(HasSubstr("'wall'"), HasSubstr("9999")));
}

// A group at rest at its map pose must keep that pose, bit for bit, while the camera moves.
TEST(GroupTracker, KeepsPoseOfGroupAtRest) {
  const Stage stage({wall()});
  GroupTracker tracker = stage.tracker();
  int changes = 0;
  GroupPose before;
  for (int f = 0; f < (test::nightly() ? 20 : 10); ++f) {
    const TrackedFrame tracked = tracker.track(stage.frame_image(f));
    const GroupEstimate& estimate = group_named(tracked, "wall");
    ASSERT_EQ(estimate.status, TrackStatus::tracked) << text_of(estimate.reason);
    EXPECT_EQ(estimate.reason.cause, PoseCause::none);
    EXPECT_EQ(estimate.tags_used, 6);
    const double error = stage.error_px(tracked, estimate, f);
    EXPECT_LT(error, 0.5);
    EXPECT_LT(error, 4.0 * estimate.predicted_overlay_error_px);
    if (f > 0) {
      EXPECT_TRUE(estimate.rests);
      changes += estimate.T_table_group.matrix() != before.matrix() ? 1 : 0;
    }
    before = estimate.T_table_group;
  }
  EXPECT_LE(changes, test::nightly() ? 2 : 1) << "noise must not be treated as motion";
}

// The map has a wrong pose for the wall; the image shows the wall at its true pose.
TEST(GroupTracker, TracksMovedWall) {
  const Stage stage({wall()});
  GroupTracker tracker = stage.tracker();
  const Placement leaning(turned(12.0, {1.0, 0.3, 0.6}), Eigen::Vector3d(0.02, 0.03, -0.01));
  const int frames = test::nightly() ? 12 : 6;
  for (int f = 0; f < frames; ++f) {
    // Halfway through, the wall is pushed to another pose.
    const Placement at =
        f < frames / 2
            ? leaning
            : Placement(leaning.rotation(), leaning.translation() + Eigen::Vector3d(0, 0.004, 0));
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, {{"wall", at}}));
    const GroupEstimate& estimate = group_named(tracked, "wall");
    ASSERT_EQ(estimate.status, TrackStatus::tracked) << f << ": " << text_of(estimate.reason);
    EXPECT_LT(stage.error_px(tracked, estimate, f, at), 0.6) << f;
    const Eigen::Vector3d p(0.0, 0.14, 0.1);
    EXPECT_LT((estimate.T_table_group * p - at * p).norm(), 0.001) << f;
  }
}

// Block and camera move as if hand-held.
TEST(GroupTracker, TracksHandHeldProp) {
  const Stage stage({wall(), block()});
  GroupTracker tracker = stage.tracker();
  int tracked_frames = 0;
  int detections = 0;
  const int frames = test::nightly() ? 30 : 15;
  for (int f = 0; f < frames; ++f) {
    const double t = f / 30.0;
    const Placement at(turned(25.0 * std::sin(4.0 * t), {0.2, 0.4, 1.0}),
                       Eigen::Vector3d(-0.05 * t, 0.02 * std::sin(5.0 * t), 0.03 * t));
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, {{"block", at}}));
    const GroupEstimate& estimate = group_named(tracked, "block");
    detections += tracked.times.full_detection ? 1 : 0;
    EXPECT_EQ(group_named(tracked, "wall").status, TrackStatus::tracked);
    if (estimate.status != TrackStatus::tracked) {
      EXPECT_NE(estimate.reason.cause, PoseCause::none);
      continue;
    }
    ++tracked_frames;
    const double error = stage.error_px(tracked, estimate, f, at);
    EXPECT_LT(error, 3.0) << f;
    EXPECT_LT(error, std::max(0.5, 4.0 * estimate.predicted_overlay_error_px)) << f;
    EXPECT_TRUE(estimate.covariance.allFinite());
  }
  EXPECT_GE(tracked_frames, frames - 2);
  EXPECT_EQ(detections, 1) << "only in the first frame, for all groups";
}

// The group moves by a fraction of a pixel per frame, less than the measurement noise. Averaging
// must not let the drawn pose lag behind by more than 0.9 px.
TEST(GroupTracker, TracksSlowMotionBelowNoise) {
  const Stage stage({block()});
  GroupTracker tracker = stage.tracker();
  for (int f = 0; f < (test::nightly() ? 24 : 16); ++f) {
    const Placement at = shifted(0.00015 * f, 0.0001 * f, 0.0);
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, {{"block", at}}));
    const GroupEstimate& estimate = group_named(tracked, "block");
    ASSERT_TRUE(estimate.has_pose()) << text_of(estimate.reason);
    const double error = stage.error_px(tracked, estimate, f, at);
    EXPECT_LT(error, 0.9) << f;
    EXPECT_LT(error, 3.0 * estimate.predicted_overlay_error_px) << f;
  }
}

TEST(GroupTracker, KeepsTablePoseIndependentOfOtherGroups) {
  const Stage stage({wall(), block()});
  std::vector<Frame> images;
  for (int f = 0; f < 6; ++f) {
    // The block is absent in some frames, so the tracker searches for it.
    Placements at;
    if (f >= 2 && f < 5) at["block"] = shifted(5.0, 0.0, 0.0);
    images.push_back(stage.frame_image(f, at));
  }
  for (const TrackingMode mode : {TrackingMode::detect, TrackingMode::automatic}) {
    TrackerOptions options;
    options.mode = mode;
    std::vector<MappedTag> of_table = stage.map().tags();
    std::erase_if(of_table, [](const MappedTag& tag) { return tag.group != kTableGroup; });
    auto alone =
        GroupTracker::create(stage.camera, TagMap::make(of_table).value(), options).value();
    auto none = GroupTracker::create(stage.camera, stage.map(), options, std::vector<std::string>())
                    .value();
    auto one = GroupTracker::create(stage.camera, stage.map(), options,
                                    std::vector<std::string>{"block", "no such"})
                   .value();
    GroupTracker all = stage.tracker(options);
    for (const Frame& frame_image : images) {
      const TrackedFrame a = alone.track(frame_image);
      const TrackedFrame b = none.track(frame_image);
      const TrackedFrame c = one.track(frame_image);
      const TrackedFrame d = all.track(frame_image);
      EXPECT_THAT(b.groups, IsEmpty());
      EXPECT_EQ(b.groups_skipped, 2);
      ASSERT_EQ(c.groups.size(), 1U);
      EXPECT_EQ(c.groups_skipped, 1);
      ASSERT_EQ(d.groups.size(), 2U);
      EXPECT_EQ(d.groups_skipped, 0);
      for (const TrackedFrame* other : {&b, &c, &d}) {
        EXPECT_EQ(a.pose.status, other->pose.status);
        EXPECT_EQ(a.pose.T_table_camera.matrix(), other->pose.T_table_camera.matrix());
        EXPECT_EQ(a.pose.covariance, other->pose.covariance);
      }
      EXPECT_EQ(c.groups[0].status, group_named(d, "block").status);
      EXPECT_EQ(c.groups[0].T_table_group.matrix(), group_named(d, "block").T_table_group.matrix());
    }
  }
}

TEST(GroupTracker, ReportsInvisibleGroupLostWithFewSearches) {
  Stage stage({wall(), block()});
  std::vector<MappedTag> drawn = stage.tags;
  std::erase_if(drawn, [](const MappedTag& tag) { return tag.group == "block"; });
  std::vector<Frame> images;
  for (int f = 0; f < 8; ++f) images.push_back(stage.frame_image(f, {}, &drawn));
  GroupTracker tracker = stage.tracker();
  int detections = 0;
  constexpr std::size_t kFrames = 40;
  for (std::size_t f = 0; f < kFrames; ++f) {
    const TrackedFrame tracked = tracker.track(images[f % 8]);
    const GroupEstimate& estimate = group_named(tracked, "block");
    EXPECT_EQ(estimate.status, TrackStatus::lost);
    EXPECT_NE(estimate.reason.cause, PoseCause::none);
    detections += tracked.times.full_detection ? 1 : 0;
  }
  EXPECT_GE(detections, 2);
  EXPECT_LE(detections, int{kFrames / 4});
}

TEST(GroupTracker, CoastsHiddenGroupThenFindsItAnywhere) {
  const Stage stage({wall()});
  std::vector<MappedTag> hidden = stage.tags;
  std::erase_if(hidden, [](const MappedTag& tag) { return tag.group == "wall"; });
  TrackerOptions options;
  options.hold_s = 0.2;
  GroupTracker tracker = stage.tracker(options);
  for (int f = 0; f < 4; ++f) static_cast<void>(tracker.track(stage.frame_image(f)));
  double previous_error_px = 0.0;
  int held = 0;
  GroupPose last;
  for (int f = 4; f < 20; ++f) {
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, {}, &hidden));
    const GroupEstimate& estimate = group_named(tracked, "wall");
    EXPECT_EQ(tracked.pose.status, TrackStatus::tracked);
    EXPECT_NE(estimate.reason.cause, PoseCause::none);
    if (f < 4 + 6) {
      ASSERT_EQ(estimate.status, TrackStatus::held) << f;
      ++held;
      EXPECT_NEAR(estimate.age_s, (f - 3) / 30.0, 1e-6);
      EXPECT_EQ(estimate.held_from, TrackStatus::tracked);
      EXPECT_GT(estimate.predicted_overlay_error_px, previous_error_px);
      previous_error_px = estimate.predicted_overlay_error_px;
      if (held > 1) {
        EXPECT_EQ(estimate.T_table_group.matrix(), last.matrix()) << "the group was at rest";
      }
      last = estimate.T_table_group;
    } else {
      EXPECT_EQ(estimate.status, TrackStatus::lost) << f;
    }
  }
  // The wall returns farther away than a search near its old pose covers.
  const Placement returned(turned(20.0, Eigen::Vector3d::UnitZ()),
                           Eigen::Vector3d(0.05, 0.06, 0.0));
  int frames = 0;
  bool found = false;
  for (int f = 20; f < 32 && !found; ++f, ++frames) {
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, {{"wall", returned}}));
    const GroupEstimate& estimate = group_named(tracked, "wall");
    found = estimate.status == TrackStatus::tracked;
    if (found) {
      EXPECT_LT(stage.error_px(tracked, estimate, f, returned), 0.5);
    }
  }
  EXPECT_TRUE(found);
  EXPECT_LE(frames, 9);
}

// A group that returns to its old pose must be tracked in its first frame, without a search.
TEST(GroupTracker, TracksReturningGroupAtOnce) {
  const Stage stage({wall()});
  std::vector<MappedTag> hidden = stage.tags;
  std::erase_if(hidden, [](const MappedTag& tag) { return tag.group == "wall"; });
  GroupTracker tracker = stage.tracker();
  for (int f = 0; f < 3; ++f) static_cast<void>(tracker.track(stage.frame_image(f)));
  for (int f = 3; f < 13; ++f) static_cast<void>(tracker.track(stage.frame_image(f, {}, &hidden)));
  const TrackedFrame tracked = tracker.track(stage.frame_image(13));
  EXPECT_EQ(group_named(tracked, "wall").status, TrackStatus::tracked)
      << text_of(group_named(tracked, "wall").reason);
  EXPECT_FALSE(tracked.times.full_detection);
}

TEST(GroupTracker, LosesGroupsWhenTableIsInvisible) {
  const Stage stage({wall()});
  std::vector<MappedTag> bare = stage.tags;
  std::erase_if(bare, [](const MappedTag& tag) { return tag.group == "table"; });
  TrackerOptions options;
  options.hold_s = 0.1;
  GroupTracker tracker = stage.tracker(options);
  for (int f = 0; f < 3; ++f) static_cast<void>(tracker.track(stage.frame_image(f)));
  GroupEstimate last;
  for (int f = 3; f < 10; ++f) {
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, {}, &bare));
    last = group_named(tracked, "wall");
    EXPECT_NE(last.status, TrackStatus::tracked);
    EXPECT_GE(static_cast<int>(last.status), static_cast<int>(tracked.pose.status));
  }
  EXPECT_EQ(last.status, TrackStatus::lost);
  EXPECT_THAT(text_of(last.reason), HasSubstr("table"));
}

TEST(GroupTracker, ContinuesWithAnotherMapWithoutSearch) {
  const Stage stage({wall()});
  std::vector<MappedTag> wrong = stage.tags;
  for (MappedTag& tag : wrong) {
    if (tag.group != "table") continue;
    tag.T_table_tag = {tag.T_table_tag.rotation(),
                       tag.T_table_tag.translation() + Eigen::Vector3d(0.002, 0.0, 0.001)};
  }
  GroupTracker tracker = GroupTracker::create(stage.camera, TagMap::make(wrong).value()).value();
  for (int f = 0; f < 3; ++f) {
    const TrackedFrame before = tracker.track(stage.frame_image(f));
    ASSERT_EQ(before.pose.status, TrackStatus::tracked);
  }
  ASSERT_TRUE(tracker.set_map(stage.camera, TagMap::make(stage.tags).value()));
  for (int f = 3; f < 6; ++f) {
    const TrackedFrame after = tracker.track(stage.frame_image(f));
    EXPECT_EQ(after.pose.status, TrackStatus::tracked);
    EXPECT_FALSE(after.times.full_detection);
    EXPECT_FALSE(after.times.roi_detection);
    EXPECT_LT(overlay_difference(stage.camera, after.pose.T_table_camera, stage.truth(f)).rms_px(),
              0.5);
    EXPECT_EQ(group_named(after, "wall").status, TrackStatus::tracked);
  }
}

TEST(GroupTracker, ContinuesWithAnotherRowTimeWithoutLosingGroups) {
  const Stage stage({wall()});
  const TagMap map = TagMap::make(stage.tags).value();
  GroupTracker tracker = GroupTracker::create(stage.camera, map).value();
  for (int f = 0; f < 3; ++f) {
    ASSERT_EQ(tracker.track(stage.frame_image(f)).pose.status, TrackStatus::tracked);
  }
  CameraParameters parameters = stage.camera.parameters();
  parameters.rolling_shutter_row_s = 1e-7;  // the images are of a global shutter
  ASSERT_TRUE(tracker.set_map(CameraModel::make(parameters).value(), map));
  for (int f = 3; f < 6; ++f) {
    const TrackedFrame after = tracker.track(stage.frame_image(f));
    EXPECT_EQ(after.pose.status, TrackStatus::tracked);
    EXPECT_FALSE(after.times.full_detection);
    EXPECT_EQ(group_named(after, "wall").status, TrackStatus::tracked);
  }
}

TEST(GroupTracker, TakesAnotherMapBeforeTheFirstFrameAndWhileLost) {
  const Stage stage({});
  const TagMap map = TagMap::make(stage.tags).value();
  GroupTracker tracker = GroupTracker::create(stage.camera, map).value();
  ASSERT_TRUE(tracker.set_map(stage.camera, map));
  EXPECT_EQ(tracker.track(stage.frame_image(0)).pose.status, TrackStatus::tracked);
  EXPECT_NE(tracker.track(Frame()).pose.status, TrackStatus::tracked);
  ASSERT_TRUE(tracker.set_map(stage.camera, map));
  EXPECT_EQ(tracker.track(stage.frame_image(2)).pose.status, TrackStatus::tracked);
}

TEST(GroupTracker, IsDeterministic) {
  const Stage stage({wall(), block()});
  GroupTracker a = stage.tracker();
  GroupTracker b = stage.tracker();
  for (int f = 0; f < (test::nightly() ? 10 : 6); ++f) {
    Placements at;
    if (f % 3 == 2) at["block"] = shifted(0.01 * f, 5.0, 0.0);
    const Frame frame_image = stage.frame_image(f, at);
    const TrackedFrame x = a.track(frame_image);
    const TrackedFrame y = b.track(frame_image);
    for (std::size_t g = 0; g < 2; ++g) {
      EXPECT_EQ(x.groups[g].status, y.groups[g].status);
      EXPECT_EQ(x.groups[g].T_table_group.matrix(), y.groups[g].T_table_group.matrix());
      EXPECT_EQ(x.groups[g].covariance, y.groups[g].covariance);
    }
  }
}

// A block enters the view while it moves, and the wall is at another pose than in the map. The
// table is tracked in every frame.
struct ArrivalScenario {
  Stage stage{{wall(), block()}};
  std::vector<Frame> images;
  std::vector<Placements> truth;
};
constexpr int kArrives = 3;  // first frame with wall and block

ArrivalScenario arriving() {
  ArrivalScenario arriving;
  std::vector<MappedTag> without = arriving.stage.tags;
  std::erase_if(without, [](const MappedTag& tag) { return tag.group != "table"; });
  for (int f = 0; f < (test::nightly() ? 14 : 10); ++f) {
    arriving.truth.push_back(
        {{"wall", shifted(0.03, 0.05, 0.0)},
         {"block", Placement(turned(1.5 * f, {0.2, 0.4, 1.0}),
                             Eigen::Vector3d(-0.1 + 0.004 * f, 0.05 - 0.003 * f, 0.03))}});
    arriving.images.push_back(f < kArrives ? arriving.stage.frame_image(f, {}, &without)
                                           : arriving.stage.frame_image(f, arriving.truth.back()));
  }
  return arriving;
}

struct Arrival {
  std::vector<TrackedFrame> frames;
  [[nodiscard]] int first_tracked(const std::string& group) const {
    for (std::size_t f = 0; f < frames.size(); ++f) {
      if (group_named(frames[f], group).status == TrackStatus::tracked) return static_cast<int>(f);
    }
    return -1;
  }
};

using Duration = std::chrono::steady_clock::duration;

Arrival arrive(const ArrivalScenario& arriving, const TrackerOptions& options,
               Duration patience = {}) {
  Arrival arrival;
  GroupTracker tracker = arriving.stage.tracker(options);
  for (const Frame& frame_image : arriving.images) {
    arrival.frames.push_back(tracker.track(frame_image));
    std::this_thread::sleep_for(patience);
  }
  if (patience == Duration()) return arrival;
  // A busy machine may have searched for longer, so the last image stays in view until the groups
  // are found.
  const auto found = [&](const char* group) {
    return group_named(arrival.frames.back(), group).status == TrackStatus::tracked;
  };
  const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(2);
  for (Frame last = arriving.images.back();
       !(found("wall") && found("block")) && std::chrono::steady_clock::now() < end;) {
    last.timestamp_ns += 33'333'333;
    arrival.frames.push_back(tracker.track(last));
    std::this_thread::sleep_for(patience);
  }
  return arrival;
}

// Returns the duration of a frame with searches for all groups, under the machine's present load.
Duration search_duration(const ArrivalScenario& arriving) {
  TrackerOptions options;
  options.search_timing = SearchTiming::in_frame;
  GroupTracker tracker = arriving.stage.tracker(options);
  const auto begin = std::chrono::steady_clock::now();
  static_cast<void>(tracker.track(arriving.images.front()));
  return std::chrono::steady_clock::now() - begin;
}

TEST(GroupTracker, NeverWaitsForSearchOnceTableIsTracked) {
  const ArrivalScenario shown = arriving();
  const Stage& stage = shown.stage;
  TrackerOptions options;
  options.search_timing = SearchTiming::in_frame;
  const Arrival waiting = arrive(shown, options);
  options.search_timing = SearchTiming::next_frame;
  const Arrival beside = arrive(shown, options);
  options.search_thread = true;
  const Arrival threaded = arrive(shown, options);
  int searches_used = 0;
  int searches_in_frame = 0;
  for (std::size_t f = 1; f < beside.frames.size(); ++f) {
    SCOPED_TRACE(f);
    const TrackedFrame& frame = beside.frames[f];
    EXPECT_EQ(frame.pose.status, TrackStatus::tracked);
    EXPECT_FALSE(frame.times.full_detection);
    EXPECT_EQ(frame.times.detect_ms, 0.0);
    searches_used += frame.times.search_used ? 1 : 0;
    searches_in_frame += waiting.frames[f].times.full_detection ? 1 : 0;
    for (const char* group : {"wall", "block"}) {
      SCOPED_TRACE(group);
      const GroupEstimate& a = group_named(frame, group);
      // The search thread must give the same results bit by bit.
      const GroupEstimate& b = group_named(threaded.frames[f], group);
      EXPECT_EQ(a.status, b.status);
      EXPECT_EQ(text_of(a.reason), text_of(b.reason));
      EXPECT_EQ(a.T_table_group.matrix(), b.T_table_group.matrix());
      EXPECT_EQ(a.covariance, b.covariance);
      EXPECT_EQ(frame.times.search_used, threaded.frames[f].times.search_used);
      // The time of a search counts as tracking time, also if another thread runs it.
      for (const TrackedFrame* one : {&frame, &threaded.frames[f]}) {
        EXPECT_EQ(one->times.search_cpu_ms > 0.0, one->times.search_used);
        EXPECT_GT(one->times.total_cpu_ms, one->times.search_cpu_ms);
      }
      // Once both kinds of search have succeeded, they must give the same poses from the next frame
      // on.
      const GroupEstimate& c = group_named(waiting.frames[f], group);
      const int both = std::max(beside.first_tracked(group), waiting.first_tracked(group));
      if (a.status != TrackStatus::tracked || c.status != TrackStatus::tracked) continue;
      const Placement& at = shown.truth[f].at(group);
      const int frame_number = static_cast<int>(f);
      EXPECT_LT(stage.error_px(frame, a, frame_number, at), 0.6);
      EXPECT_LT(stage.error_px(waiting.frames[f], c, frame_number, at), 0.6);
      if (frame_number > both + 1) {
        EXPECT_NEAR(stage.error_px(frame, a, frame_number, at),
                    stage.error_px(waiting.frames[f], c, frame_number, at), 0.3);
      }
    }
  }
  EXPECT_GE(searches_used, 2);
  EXPECT_GE(searches_in_frame, 2);
  for (const char* group : {"wall", "block"}) {
    const int in_frame = waiting.first_tracked(group);
    ASSERT_GE(in_frame, kArrives) << group;
    EXPECT_GT(beside.first_tracked(group), in_frame - 1) << group;
    EXPECT_LE(beside.first_tracked(group), in_frame + 1) << group;
  }
}

// With enough time, the result of a background search is used in the next frame.
TEST(GroupTracker, FindsSameGroupsByBackgroundSearch) {
  const ArrivalScenario shown = arriving();
  TrackerOptions options;
  options.search_timing = SearchTiming::when_done;
  const Arrival live = arrive(shown, options, 2 * search_duration(shown));
  for (const char* group : {"wall", "block"}) {
    const int first = live.first_tracked(group);
    ASSERT_GE(first, kArrives) << group;
    for (std::size_t f = static_cast<std::size_t>(first); f < live.frames.size(); ++f) {
      const GroupEstimate& estimate = group_named(live.frames[f], group);
      EXPECT_EQ(estimate.status, TrackStatus::tracked) << text_of(estimate.reason);
      const std::size_t image = std::min(f, shown.images.size() - 1);
      EXPECT_LT(shown.stage.error_px(live.frames[f], estimate, static_cast<int>(image),
                                     shown.truth[image].at(group)),
                0.6);
    }
  }
  for (std::size_t f = 1; f < live.frames.size(); ++f) {
    EXPECT_EQ(live.frames[f].times.detect_ms, 0.0);
  }
  // Without waiting, the table may be found some frames late, because the full-resolution search
  // runs in the background. Once found, the table must stay tracked. The tracker may be destroyed
  // during a search.
  const Arrival hurried = arrive(shown, options);
  bool found = false;
  for (const TrackedFrame& frame : hurried.frames) {
    const bool tracked = frame.pose.status == TrackStatus::tracked;
    EXPECT_TRUE(tracked || !found) << text_of(frame.pose.reason);
    found = found || tracked;
  }
  EXPECT_TRUE(found);
}

// On a machine that takes seconds per frame, the view has changed when a background search ends.
TEST(GroupTracker, FindsTableOnSlowMachine) {
  const Stage stage({wall()});
  std::vector<Frame> images;
  const int frames = test::nightly() ? 12 : 7;
  for (int f = 0; f < frames; ++f) {
    images.push_back(stage.frame_image(5 * f));
    images.back().timestamp_ns = (1 + f) * std::int64_t{4'000'000'000};
  }
  for (const SearchTiming timing : {SearchTiming::in_frame, SearchTiming::when_done}) {
    TrackerOptions options;
    options.search_timing = timing;
    GroupTracker tracker = stage.tracker(options);
    int tracked = 0;
    for (const Frame& frame : images) {
      tracked += tracker.track(frame).pose.status == TrackStatus::tracked;
      // Time for a background search.
      if (timing == SearchTiming::when_done)
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    EXPECT_GE(tracked, frames - 1) << (timing == SearchTiming::in_frame ? "in frame" : "beside");
  }
}

TEST(GroupTracker, RecoversFromInvalidFramesAndClockJumps) {
  const Stage stage({wall()});
  GroupTracker tracker = stage.tracker();
  for (int f = 0; f < 3; ++f) static_cast<void>(tracker.track(stage.frame_image(f)));
  EXPECT_FALSE(group_named(tracker.track(Frame{}), "wall").has_pose() &&
               group_named(tracker.track(Frame{}), "wall").status == TrackStatus::tracked);
  FrameBuffer small = allocate_frame(PixelFormat::grey8, 64, 48);
  for (int y = 0; y < 48; ++y)
    std::fill_n(small.plane_data[0] + y * small.frame.planes[0].stride, 64, std::uint8_t{70});
  small.frame.timestamp_ns = 2'000'000'000;
  EXPECT_NE(group_named(tracker.track(small.frame), "wall").status, TrackStatus::tracked);
  Frame back = stage.frame_image(1);
  back.timestamp_ns = 5;
  const TrackedFrame again = tracker.track(back);
  EXPECT_EQ(group_named(again, "wall").status, TrackStatus::tracked)
      << text_of(group_named(again, "wall").reason);
}

}  // namespace
}  // namespace group_tracker_test
}  // namespace penumbra
