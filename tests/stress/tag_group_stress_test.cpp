// Rigid tag groups in difficult cases: duplicates, single tags, edge-on views, occlusion by another
// group, inconsistent maps. Results must be finite, and no wrong pose may have the status tracked.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "support/group_stage.hpp"
#include "support/test_form.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace tag_group_stress {
namespace {

using test::block;
using test::group_named;
using test::nightly;
using test::Placements;
using test::shifted;
using test::Stage;
using test::turned;
using test::wall;

// Checks poses and covariances against the true placements `at`.
void expect_consistent(const Stage& stage, const TrackedFrame& tracked, int frame,
                       const Placements& at) {
  for (const GroupEstimate& group : tracked.groups) {
    SCOPED_TRACE(group.name);
    if (!group.has_pose()) continue;
    EXPECT_TRUE(group.T_table_group.is_finite());
    EXPECT_TRUE(group.covariance.allFinite());
    EXPECT_FALSE(std::isnan(group.predicted_overlay_error_px));
    EXPECT_GE(static_cast<int>(group.status), static_cast<int>(tracked.pose.status));
    if (group.status != TrackStatus::tracked) {
      EXPECT_NE(group.reason.cause, PoseCause::none);
      continue;
    }
    const auto place = at.find(group.name);
    const double error = stage.error_px(tracked, group, frame,
                                        place == at.end() ? test::Placement() : place->second);
    EXPECT_LT(error, 5.0);
    EXPECT_LT(error, std::max(1.0, 4.0 * group.predicted_overlay_error_px));
    EXPECT_LT(group.predicted_overlay_error_px, 2.0);
  }
}

TEST(TagGroupStress, RejectsIdInTwoGroups) {
  std::vector<MappedTag> tags = wall();
  tags.push_back(tags.front());
  tags.back().group = "block";
  const auto map = TagMap::make(tags);
  ASSERT_FALSE(map);
  EXPECT_NE(map.error().message.find("listed twice"), std::string::npos);
}

// A second print of a tag of the block or of the wall lies on the table.
TEST(TagGroupStress, IgnoresCopyOfGroupTag) {
  const Stage stage({wall(), block()});
  for (const int copied : {test::kBlockId, test::kWallId + 1}) {
    std::vector<MappedTag> drawn = stage.tags;
    for (const MappedTag& tag : stage.tags) {
      if (tag.id != copied) continue;
      MappedTag& copy = drawn.emplace_back(tag);
      copy.group = "table";
      copy.T_table_tag = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(-0.16, -0.05, 0.0)};
    }
    GroupTracker tracker = stage.tracker();
    int seen = 0;
    const int frames = nightly() ? 30 : 5;
    for (int f = 0; f < frames; ++f) {
      const Placements at = {{"block", shifted(-0.002 * f, 0.001 * f, 0.001 * f)}};
      const TrackedFrame tracked = tracker.track(stage.frame_image(f, at, &drawn));
      expect_consistent(stage, tracked, f, at);
      EXPECT_EQ(tracked.pose.status, TrackStatus::tracked);
      EXPECT_EQ(group_named(tracked, "wall").status, TrackStatus::tracked);
      seen += group_named(tracked, "block").has_pose() ? 1 : 0;
    }
    if (copied != test::kBlockId) {
      EXPECT_GE(seen, nightly() ? 7 : frames - 1);
    }
  }
}

// The image of a single tag fits two poses. The tag rotates slowly through frontal and edge-on
// views.
TEST(TagGroupStress, NeverTracksWrongPoseOfSingleTagGroup) {
  std::vector<MappedTag> single = block();
  single.resize(1);
  for (const double size_m : {0.025, 0.07}) {
    SCOPED_TRACE(size_m);
    single[0].size_m = size_m;
    const Stage stage({single});
    GroupTracker tracker = stage.tracker();
    int tracked_frames = 0;
    const int frames = nightly() ? 180 : 28;
    const double step = 180.0 / frames;
    for (int f = 0; f < frames; ++f) {
      SCOPED_TRACE(f);
      const Eigen::Vector3d centre = single[0].T_table_tag.translation();
      const Eigen::Quaterniond R = turned(90.0 - step * f, Eigen::Vector3d::UnitX());
      const Placements at = {{"block", test::Placement(R, Eigen::Vector3d(centre - R * centre))}};
      const TrackedFrame tracked = tracker.track(stage.frame_image(f, at));
      expect_consistent(stage, tracked, f, at);
      tracked_frames += group_named(tracked, "block").status == TrackStatus::tracked ? 1 : 0;
    }
    if (size_m > 0.05) {
      EXPECT_GE(tracked_frames, frames / 4);
    }
  }
}

// The block moves between camera and wall, then in front of the table's tags.
TEST(TagGroupStress, TracksGroupsThatOccludeEachOther) {
  const Stage stage({wall(), block()});
  GroupTracker tracker = stage.tracker();
  int wall_tracked = 0;
  int block_seen = 0;
  const int frames = nightly() ? 60 : 16;
  for (int f = 0; f < frames; ++f) {
    SCOPED_TRACE(f);
    const double s = static_cast<double>(f) / frames;
    const Placements at = {{"block", shifted(-0.28 * s, 0.06 - 0.1 * s, 0.05 - 0.03 * s)}};
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, at));
    expect_consistent(stage, tracked, f, at);
    EXPECT_EQ(tracked.pose.status, TrackStatus::tracked);
    EXPECT_LT(
        overlay_difference(stage.camera, tracked.pose.T_table_camera, stage.truth(f)).rms_px(),
        1.0);
    wall_tracked += group_named(tracked, "wall").status == TrackStatus::tracked ? 1 : 0;
    block_seen += group_named(tracked, "block").tags_used > 0 ? 1 : 0;
  }
  EXPECT_GE(wall_tracked, frames - 2);
  EXPECT_GE(block_seen, frames - 4);
}

// One or half of the wall's tags are displaced in the images, so the map is wrong. Then two groups
// have the same pose in the map.
TEST(TagGroupStress, NeverTracksWrongPoseWhenMapIsInconsistent) {
  for (const int wrong : {1, 3}) {
    SCOPED_TRACE(wrong);
    const Stage stage({wall()});
    std::vector<MappedTag> drawn = stage.tags;
    int remaining = wrong;
    int moved_id = -1;  // id of the last displaced tag
    for (MappedTag& tag : drawn) {
      if (tag.group != "wall" || remaining-- <= 0) continue;
      moved_id = tag.id;
      tag.T_table_tag = {tag.T_table_tag.rotation(),
                         tag.T_table_tag.translation() + Eigen::Vector3d(0.012, 0.0, -0.006)};
    }
    GroupTracker tracker = stage.tracker();
    for (int f = 0; f < (nightly() ? 6 : 4); ++f) {
      const TrackedFrame tracked = tracker.track(stage.frame_image(f, {}, &drawn));
      EXPECT_EQ(tracked.pose.status, TrackStatus::tracked);
      if (wrong == 1) {
        expect_consistent(stage, tracked, f, {});
        EXPECT_EQ(group_named(tracked, "wall").status, TrackStatus::tracked);
        EXPECT_THAT(group_named(tracked, "wall").tags_rejected,
                    testing::ElementsAre(testing::Field(&RejectedTag::id, moved_id)));
        EXPECT_THAT(tracked.pose.tags_rejected, testing::IsEmpty())
            << "no tag of the table may be rejected";
      } else {
        EXPECT_NE(group_named(tracked, "wall").status, TrackStatus::tracked)
            << "the correct half is ambiguous";
      }
    }
  }
  // Both groups have the same pose in the map, but different poses in the images.
  std::vector<MappedTag> door = wall(3, 1);
  for (MappedTag& tag : door) {
    tag.id += 50;
    tag.group = "door";
  }
  const Stage stage({wall(3, 1), door});
  const Placements at = {{"wall", shifted(0.0, 0.02, 0.06)}, {"door", shifted(0.0, -0.01, -0.05)}};
  GroupTracker tracker = stage.tracker();
  for (int f = 0; f < (nightly() ? 6 : 4); ++f) {
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, at));
    expect_consistent(stage, tracked, f, at);
    EXPECT_EQ(group_named(tracked, "wall").status, TrackStatus::tracked)
        << text_of(group_named(tracked, "wall").reason);
    EXPECT_EQ(group_named(tracked, "door").status, TrackStatus::tracked)
        << text_of(group_named(tracked, "door").reason);
  }
}

// Twelve groups of one tag each move independently.
TEST(TagGroupStress, TracksTwelveIndependentGroups) {
  std::vector<std::vector<MappedTag>> parts;
  for (int k = 0; k < 12; ++k) {
    std::vector<MappedTag> one = block();
    one.resize(1);
    one[0].id = 150 + k;
    one[0].group = fmt::format("coin {}", k);
    one[0].T_table_tag = {Eigen::Quaterniond::Identity(),
                          Eigen::Vector3d(-0.165 + 0.06 * (k % 6), 0.13 - 0.26 * (k / 6), 0.0)};
    parts.push_back(one);
  }
  const Stage stage(parts);
  GroupTracker tracker = stage.tracker();
  int placed = 0;
  const int frames = 6;
  for (int f = 0; f < frames; ++f) {
    Placements at;
    for (int k = 0; k < 12; ++k)
      at[fmt::format("coin {}", k)] = shifted(0.0, 0.0006 * f * (k - 6), 0.0005 * f);
    const TrackedFrame tracked = tracker.track(stage.frame_image(f, at));
    ASSERT_EQ(tracked.groups.size(), 12U);
    expect_consistent(stage, tracked, f, at);
    for (const GroupEstimate& group : tracked.groups) placed += group.tags_used > 0 ? 1 : 0;
  }
  EXPECT_GE(placed, frames * 8);
}

}  // namespace
}  // namespace tag_group_stress
}  // namespace penumbra
