#include "core/geometry/tracking_reasons.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

TEST(PoseReason, HasTextForEachCause) {
  EXPECT_EQ(text_of(PoseReason{}), "");
  EXPECT_EQ(text_of(not_measured("not {seen}")), "not {seen}");
  EXPECT_EQ(text_of({PoseCause::two_poses}), "two poses fit");
  EXPECT_EQ(text_of({PoseCause::inconsistent_tags}), "the tags are inconsistent with each other");
  EXPECT_EQ(text_of({PoseCause::misfit, 22.44}), "the tags do not fit the map (22.4 px)");
  EXPECT_EQ(text_of({PoseCause::out_of_sight}), "the table's centre is out of sight");
  EXPECT_EQ(text_of({PoseCause::uncertain_lens, 2.0}),
            "the camera file knows its lens to 2.0 px only; calibrate it from more views");
  EXPECT_EQ(text_of({PoseCause::uncertain_map, 2.5}),
            "the few tags in view are inconsistent with the map: predicted error 2.5 px");
  EXPECT_EQ(text_of({PoseCause::large_error, 2.5}), "predicted error 2.5 px");
  EXPECT_EQ(text_of({PoseCause::uncertain_table, 0.0, "two poses fit"}),
            "the table is uncertain: two poses fit");
}

TEST(TagRejection, HasReportKeyAndText) {
  EXPECT_EQ(key_of(TagRejection::inconsistent), "tags_left_out");
  EXPECT_EQ(text_of(TagRejection::inconsistent, "41", "the map", 2),
            "tag 41 is inconsistent with the map: rejected in 2 frames (measure it again, or make "
            "a new map: penumbra map)");
}

}  // namespace
}  // namespace penumbra
