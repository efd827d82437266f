#include "calib/target/target.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "support/paths.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

Result<Target> target_of(const std::string& text) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "target.yaml";
  std::ofstream(file) << text;
  return load_target(file);
}

TEST(Target, CountsKalibrGridFromBottomLeft) {
  const auto target = target_of(
      "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 4\ntagSize: 0.03\ntagSpacing: 0.3\n");
  ASSERT_TRUE(target) << target.error().message;
  ASSERT_EQ(target->points.size(), 4U * 24U);
  const MappedTag* first = target->tags->find(TagFamily::tag36h11, 0);
  const MappedTag* right = target->tags->find(TagFamily::tag36h11, 1);
  const MappedTag* above = target->tags->find(TagFamily::tag36h11, 6);
  ASSERT_TRUE(first && right && above);
  EXPECT_NEAR(right->T_table_tag.translation().x() - first->T_table_tag.translation().x(), 0.039,
              1e-12);
  EXPECT_NEAR(above->T_table_tag.translation().y() - first->T_table_tag.translation().y(), 0.039,
              1e-12);
  EXPECT_TRUE(target->may_have_squares);
}

TEST(Target, ReadsChessboardsOfBothFormats) {
  const auto ours =
      target_of("target_type: checkerboard\ninner_cols: 9\ninner_rows: 6\nsquare_m: 0.025\n");
  ASSERT_TRUE(ours) << ours.error().message;
  ASSERT_EQ(ours->points.size(), 54U);
  EXPECT_NEAR(ours->points[0].x(), -0.1, 1e-12);
  EXPECT_NEAR(ours->points[0].y(), 0.0625, 1e-12);
  const auto kalibr = target_of(
      "target_type: 'checkerboard'\ntargetCols: 9\ntargetRows: 6\nrowSpacingMeters: 0.025\n"
      "colSpacingMeters: 0.025\n");
  ASSERT_TRUE(kalibr) << kalibr.error().message;
  EXPECT_EQ(kalibr->points.size(), ours->points.size());
}

TEST(Target, PlacesTagInEveryWhiteCharucoSquare) {
  const auto target = target_of(
      "target_type: charuco\ncolumns: 8\nrows: 6\nsquare_m: 0.03\ntag_m: 0.022\nfamily: "
      "tag36h11\n");
  ASSERT_TRUE(target) << target.error().message;
  EXPECT_EQ(target->points.size(), 35U);
  EXPECT_EQ(target->tags->tags().size(), 24U);
}

TEST(Target, ReadsCharucoWithOpenCvDictionaries) {
  const std::string text =
      "target_type: charuco\ncolumns: 8\nrows: 8\nsquare_m: 0.0254\ntag_m: 0.01905\n";
  const auto board = target_of(text + "dictionary: DICT_4X4_50\n");
  ASSERT_TRUE(board) << board.error().message;
  EXPECT_EQ(board->tags->tags().front().family, TagFamily::aruco_4x4_50);
  EXPECT_GT(board->tags->tags()[0].T_table_tag.translation().x(),
            board->points[0].x() - 0.0255 + 0.0254);  // the second square of the first row
  // Boards of OpenCV before 4.6 with an even number of rows began with a white square.
  const auto legacy = target_of(text + "dictionary: 4x4_50\nlegacy: true\n");
  ASSERT_TRUE(legacy) << legacy.error().message;
  EXPECT_LT(legacy->tags->tags()[0].T_table_tag.translation().x(), legacy->points[0].x());
  EXPECT_FALSE(target_of(text + "dictionary: 4x4_50\nlegacy: perhaps\n"));
}

TEST(Target, ReportsInvalidValue) {
  const auto message = [](const std::string& text) {
    const auto target = target_of(text);
    return target ? std::string("(no error)") : target.error().message;
  };
  EXPECT_THAT(message("target_type: checkerboard\ninner_cols: 9\ninner_rows: 6\nsquare_m: 25\n"),
              HasSubstr("did you mean 0.025"));
  EXPECT_THAT(message("target_type: checkerboard\ninner_cols: 9\ninner_rows: 6\nsquare_m: -1\n"),
              HasSubstr("give metres"));
  EXPECT_THAT(message("target_type: checkerboard\ninner_cols: 9\nsquare_m: 0.025\n"),
              HasSubstr("inner_rows: is missing"));
  EXPECT_THAT(message("target_type: circles\n"), HasSubstr("'circles' is not known"));
  EXPECT_THAT(message("a: b\n"), HasSubstr("target_type"));
  EXPECT_THAT(
      message("target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.03\ntagSpacing: 0\n"),
      HasSubstr("tagSpacing"));
  EXPECT_THAT(message("target_type: charuco\ncolumns: 8\nrows: 6\nsquare_m: 0.03\ntag_m: "
                      "0.03\nfamily: tag36h11\n"),
              HasSubstr("white margin"));
  EXPECT_THAT(message("target_type: charuco\ncolumns: 8\nrows: 6\nsquare_m: 0.03\ntag_m: "
                      "0.02\nfamily: DICT_7X7_50\n"),
              HasSubstr("DICT_7X7_50"));
}

}  // namespace
}  // namespace penumbra
