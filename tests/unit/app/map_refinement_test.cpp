// Refinement of map and row time while tracking, on a rendered session with exact truth.
#include "app/session/map_refinement.hpp"

#include <gtest/gtest.h>

#include <tuple>
#include <vector>

#include "calib/refinement/residual_watch.hpp"
#include "support/aligned_map.hpp"
#include "support/hand_held_session.hpp"
#include "support/rolling_camera.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

constexpr int kFrames = 40;

struct Refined {
  MapRefinementReport report;
  RefinedFiles files;
};

// Tracks a session with the given camera and map, which are refined meanwhile.
Refined refine(const test::Session& session, const CameraModel& camera,
               const std::vector<MappedTag>& given) {
  auto renderer = PatternRenderer::create(session.camera, session.tags).value();
  const TagMap map = TagMap::make(given).value();
  auto tracker = GroupTracker::create(camera, map).value();
  const auto watch = ResidualWatch::create(camera, map).value();
  MapRefinement refinement(camera, map, RefinementTiming::in_frame);
  Refined result;
  for (int f = 0; f < kFrames; ++f) {
    TrackedFrame tracked = tracker.track(session.image(renderer, f));
    std::ignore = watch->observe(tracked);
    if (const auto refined = refinement.observe(tracked, watch->latest())) {
      EXPECT_TRUE(tracker.set_map(refined->camera, refined->map));
      EXPECT_TRUE(watch->restart(refined->camera, refined->map));
    }
  }
  result.files = refinement.files(std::nullopt);
  result.report = refinement.report();
  return result;
}

TEST(MapRefinement, FindsRowTimeAndShapeOfBentSheet) {
  constexpr double kRow_s = 4e-5;
  test::Session session = test::hand_held_session(2);
  const CameraModel given = session.camera;
  const std::vector<MappedTag> flat = session.tags;
  session.camera = test::with_row_time(given, kRow_s);
  session.tags = test::bent_sheet(flat);
  const Refined refined = refine(session, given, flat);
  ASSERT_TRUE(refined.report.row_time);
  EXPECT_NEAR(refined.report.row_time->seconds, kRow_s, 0.05 * kRow_s);
  EXPECT_EQ(refined.files.camera.parameters().rolling_shutter_row_s,
            refined.report.row_time->seconds);
  ASSERT_TRUE(refined.files.record);
  EXPECT_EQ(refined.files.record->row_time_sigma_s, refined.report.row_time->sigma_s);
  EXPECT_GE(refined.report.refinements, 1);
  EXPECT_LT(test::largest_error_m(refined.files.map, session.tags),
            0.2 * test::largest_error_m(TagMap::make(flat).value(), session.tags));
}

}  // namespace
}  // namespace penumbra
