// The printed sheet, measured: the PDF is rendered at 300 dpi and its tags are detected on it.
#include "calib/target_sheet.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <limits>

#include "core/image_file.hpp"
#include "support/paths.hpp"
#include "tracking/tag_detector.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

constexpr double kPixelsPerMetre = 300.0 / 0.0254;

Frame rendered(const std::filesystem::path& pdf) {
  const std::filesystem::path base = pdf.parent_path() / "page";
  const std::string command =
      "pdftoppm -r 300 -gray -png -singlefile '" + pdf.string() + "' '" + base.string() + "'";
  EXPECT_EQ(std::system(command.c_str()), 0) << command;
  Result<Frame> frame = load_image(base.string() + ".png");
  EXPECT_TRUE(frame) << frame.error().message;
  return std::move(frame).value();
}

void expect_true_scale(const TagBoard& board, const PageSize& page) {
  const test::TemporaryFolder folder;
  const std::filesystem::path pdf = folder.path() / "sheet.pdf";
  const Result<void> written = write_tag_board(pdf, board, page);
  ASSERT_TRUE(written) << written.error().message;
  const Frame frame = rendered(pdf);
  std::vector<std::uint8_t> scratch;
  TagDetector detector = TagDetector::create(std::array{board.family}).value();
  const std::vector<TagDetection> detections = detector.detect(luma(frame, scratch));
  const TagMap map = tag_map_of(board).value();
  ASSERT_EQ(detections.size(), map.tags().size()) << "every tag is found";

  // Against the map, with the board's centre as the only freedom: nothing is scaled or turned to
  // fit.
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();
  std::vector<Eigen::Vector2d> differences_m;
  for (const TagDetection& detection : detections) {
    const MappedTag* tag = map.find(detection.family, detection.id);
    ASSERT_NE(tag, nullptr);
    const auto corners = tag->corners();
    for (std::size_t i = 0; i < 4; ++i) {
      const Eigen::Vector2d measured(detection.corners_px[i].x() / kPixelsPerMetre,
                                     -detection.corners_px[i].y() / kPixelsPerMetre);
      differences_m.emplace_back(measured - corners[i].head<2>());
      offset += differences_m.back();
    }
  }
  offset /= static_cast<double>(differences_m.size());
  for (const Eigen::Vector2d& difference : differences_m)
    EXPECT_LT((difference - offset).norm(), 1e-4) << "0.1 mm";
}

TEST(TargetSheet, IsPrintedAtTrueScale) {
  expect_true_scale(TagBoard{}, page_size_from_string("a4").value());
}

TEST(TargetSheet, AnyPageFamilyAndLayout) {
  expect_true_scale({TagFamily::tag36h11, 100, 2, 5, 0.03, 0.04},
                    page_size_from_string("letter").value());
  expect_true_scale({TagFamily::tag25h9, 3, 3, 2, 0.035, 0.05},
                    page_size_from_string("150x200").value());
}

TEST(TargetSheet, IdsRunInReadingOrderAroundTheCentre) {
  const TagMap map = tag_map_of(TagBoard{}).value();
  EXPECT_EQ(map.tags().size(), 12U);
  EXPECT_TRUE(map.find(TagFamily::tag36h11, 0)
                  ->T_table_tag.translation()
                  .isApprox(Eigen::Vector3d(-0.0825, 0.055, 0.0)));
  EXPECT_TRUE(map.find(TagFamily::tag36h11, 11)
                  ->T_table_tag.translation()
                  .isApprox(Eigen::Vector3d(0.0825, -0.055, 0.0)));
}

TEST(TargetSheet, AMeasuredRulerScalesTheMap) {
  const TagMap map = tag_map_of(TagBoard{}, 0.992).value();
  EXPECT_NEAR(map.tags()[0].size_m, 0.04 * 0.992, 1e-12);
  EXPECT_NEAR(map.tags()[0].T_table_tag.translation().x(), -0.0825 * 0.992, 1e-12);
  EXPECT_FALSE(tag_map_of(TagBoard{}, 0.0992)) << "99.2 given as metres or the like";
}

TEST(TargetSheet, SaysWhatDoesNotFit) {
  const test::TemporaryFolder folder;
  TagBoard board;
  board.columns = 10;
  const auto written =
      write_tag_board(folder.path() / "sheet.pdf", board, page_size_from_string("a4").value());
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, HasSubstr("does not fit on a page of 210 x 297 mm"));
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "sheet.pdf"));

  board = TagBoard{};
  board.pitch_m = 0.045;
  EXPECT_THAT(tag_map_of(board).error().message, HasSubstr("need 0.0500 m each"));
  board = TagBoard{};
  board.first_id = 580;  // 36h11 ends at 586
  EXPECT_FALSE(tag_map_of(board));
  board = TagBoard{};
  board.tag_size_m = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(tag_map_of(board));
  EXPECT_THAT(page_size_from_string("b9").error().message, HasSubstr("a4"));
  EXPECT_FALSE(page_size_from_string("210x"));
  EXPECT_FALSE(write_tag_board(folder.path() / "no-such-folder" / "sheet.pdf", TagBoard{},
                               page_size_from_string("a4").value()));
}

}  // namespace
}  // namespace penumbra
