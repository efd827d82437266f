#include "core/geometry/tracking_reasons.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

TEST(PoseReason, HasTextForEachCause) {
  EXPECT_EQ(text_of(PoseReason{}), "");
  EXPECT_EQ(text_of({PoseCause::no_tag}), "no tag of the table was found");
  EXPECT_EQ(text_of({.cause = PoseCause::tags_not_in_map, .tags = 24}),
            "24 tags in view, none of them of this board (--tags)");
  EXPECT_EQ(text_of({.cause = PoseCause::wrong_size, .sizes_px = {640, 480, 1280, 720}}),
            "the frame is 640x480, the camera file says 1280x720");
  EXPECT_EQ(text_of({PoseCause::two_poses}), "two poses fit");
  EXPECT_EQ(text_of({PoseCause::inconsistent_tags}), "the tags are inconsistent with each other");
  EXPECT_EQ(text_of({PoseCause::misfit, 22.44}), "the tags do not fit the map (22.4 px)");
  EXPECT_EQ(text_of({PoseCause::out_of_sight}), "the table's centre is out of sight");
  EXPECT_EQ(text_of({PoseCause::uncertain_lens, 2.0}),
            "the lens is known to 2.0 px only; calibrate the camera from more views");
  EXPECT_EQ(text_of({PoseCause::uncertain_map, 2.5}),
            "the few tags in view are inconsistent with the map: predicted error 2.5 px");
  EXPECT_EQ(text_of({PoseCause::large_error, 2.5}), "predicted error 2.5 px");
  EXPECT_EQ(text_of({.cause = PoseCause::systematic_error,
                     .error_px = 2.0,
                     .suspects = {.lens = true, .row_time = true}}),
            "predicted error 2.0 px because of the lens or row time");
}

TEST(PoseReason, OfGroupNamesReasonOfTable) {
  EXPECT_EQ(text_of(reason_by_table({PoseCause::large_error, 2.5})),
            "the table is uncertain: predicted error 2.5 px");
  EXPECT_FALSE(is_same_kind(reason_by_table({PoseCause::large_error, 2.5}),
                            reason_by_table({PoseCause::two_poses})));
}

TEST(PoseReason, HasGeneralTextWithoutNumbers) {
  EXPECT_EQ(general_text_of({PoseCause::large_error, 2.5}), "predicted error N px");
  EXPECT_TRUE(is_same_kind({PoseCause::large_error, 2.5}, {PoseCause::large_error, 13.0}));
  EXPECT_EQ(general_text_of({PoseCause::wrong_size}), "the frame is NxN, the camera file says NxN");
}

TEST(Suspects, AreNamed) {
  EXPECT_EQ(text_of(Suspects{.lens = true}), "lens");
  EXPECT_EQ(text_of(Suspects{.tag_map = true, .row_time = true}), "tag map or row time");
  EXPECT_EQ(text_of(Suspects{.tag_map = true, .lens = true, .certain = true}), "tag map, lens");
}

TEST(TagRejection, HasReportKeyAndText) {
  EXPECT_EQ(key_of(TagRejection::inconsistent), "tags_left_out");
  EXPECT_EQ(text_of(TagRejection::inconsistent, "41", "the map", 2),
            "tag 41 is inconsistent with the map: rejected in 2 frames (measure it again, or make "
            "a new map: penumbra map)");
}

}  // namespace
}  // namespace penumbra
