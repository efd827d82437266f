// Measures the printed sheet: renders the PDF at 300 dpi and detects its tags.
#include "calib/target/target_sheet.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>

#include "calib/target/tag_census.hpp"
#include "calib/target/target_detector.hpp"
#include "core/image/image_file.hpp"
#include "core/text/text.hpp"
#include "support/paths.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

constexpr double kPixelsPerMetre = 300.0 / 0.0254;

Frame rendered(const std::filesystem::path& pdf, int dots_per_inch = 300) {
  const std::filesystem::path base = pdf.parent_path() / "page";
  const std::string command = fmt::format("pdftoppm -r {} -gray -png -singlefile '{}' '{}'",
                                          dots_per_inch, pdf.string(), base.string());
  EXPECT_EQ(std::system(command.c_str()), 0) << command;
  Result<Frame> frame = load_image(base.string() + ".png");
  EXPECT_TRUE(frame) << frame.error().message;
  return std::move(frame).value();
}

void expect_true_scale(const TagBoard& board, const PageSize& page) {
  const test::TemporaryFolder folder;
  const std::filesystem::path pdf = folder.path() / "sheet.pdf";
  const Result<void> written = write_sheet(pdf, board, page);
  ASSERT_TRUE(written) << written.error().message;
  const Frame frame = rendered(pdf);
  std::vector<std::uint8_t> scratch;
  TagDetector detector = TagDetector::create(std::array{board.family}).value();
  const std::vector<TagDetection> detections = detector.detect(luma(frame, scratch));
  const TagMap map = tag_map_of(board).value();
  ASSERT_EQ(detections.size(), map.tags().size()) << "all tags must be detected";

  // Fits only the board's centre before the comparison with the map, neither scale nor rotation.
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

TEST(TargetSheet, PrintsAtTrueScale) {
  expect_true_scale(TagBoard{}, page_size_from_string("a4").value());
}

TEST(TargetSheet, PrintsAnyPageFamilyAndLayoutAtTrueScale) {
  expect_true_scale({TagFamily::tag36h11, 100, 2, 5, 0.03, 0.04},
                    page_size_from_string("letter").value());
  expect_true_scale({TagFamily::tag25h9, 3, 3, 2, 0.035, 0.05},
                    page_size_from_string("150x200").value());
}

// A page as printed, detected with the target file written with it.
struct DetectedSheet {
  Target target;
  TargetView view;
  Frame frame;
};

Frame printed_page(const SheetTarget& sheet, const PageSize& page) {
  const test::TemporaryFolder folder;
  const auto pdf = folder.path() / "sheet.pdf";
  const auto written = write_sheet(pdf, sheet, page);
  EXPECT_TRUE(written) << written.error().message;
  return rendered(pdf);
}

DetectedSheet printed(const SheetTarget& sheet, const PageSize& page) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "target.yaml";
  const auto saved = save_target(file, sheet);
  EXPECT_TRUE(saved) << saved.error().message;
  DetectedSheet sheet_image{load_target(file).value(), {}, printed_page(sheet, page)};
  std::vector<std::uint8_t> scratch;
  TargetDetector detector = TargetDetector::create(sheet_image.target).value();
  sheet_image.view = detector.detect(luma(sheet_image.frame, scratch));
  return sheet_image;
}

// The defaults of each family are a sheet that fits the page, with all tags readable.
TEST(TargetSheet, HasReadableDefaultsForEveryFamily) {
  const PageSize a4 = page_size_from_string("a4").value();
  for (const TagFamily family : distinct_tag_families()) {
    AprilGrid grid = april_grid_of(family).value();
    grid.rows = 4;
    for (const SheetTarget& target :
         {SheetTarget(tag_board_of(family).value()), SheetTarget(grid)}) {
      ASSERT_TRUE(check_fits(target, a4)) << to_string(family);
      const test::TemporaryFolder folder;
      ASSERT_TRUE(write_sheet(folder.path() / "sheet.pdf", target, a4)) << to_string(family);
      constexpr int kDotsPerInch = 100;
      const Frame frame = rendered(folder.path() / "sheet.pdf", kDotsPerInch);
      TagDetectorOptions options;
      options.max_corrected_bits = 0;
      std::vector<std::uint8_t> scratch;
      TagDetector detector = TagDetector::create(std::array{family}, options).value();
      const std::size_t count = std::holds_alternative<AprilGrid>(target) ? 24 : 12;
      EXPECT_EQ(detector.detect(luma(frame, scratch)).size(), count)
          << to_string(family) << ", sheet " << target.index();
    }
  }
}

// A target file of tag36h11, and images of a sheet of another family.
TEST(TargetSheet, IsNamedByCensusOfAnotherFamily) {
  const test::TemporaryFolder folder;
  const auto pdf = folder.path() / "sheet.pdf";
  ASSERT_TRUE(write_sheet(pdf, tag_board_of(TagFamily::tag25h9).value(),
                          page_size_from_string("a4").value()));
  const Frame frame = rendered(pdf, 100);
  std::vector<std::uint8_t> scratch;
  TagCensus census(tag_map_of(TagBoard{}).value());
  for (int i = 0; i < 3; ++i) census.add({}, luma(frame, scratch));
  ASSERT_EQ(census.differences().size(), 1U);
  EXPECT_THAT(
      census.differences().front(),
      testing::AllOf(HasSubstr("tag25h9 0 to 11"), HasSubstr("give the file of the sheet")));
}

TEST(TargetSheet, KeepsDefaultsOfUsualFamilies) {
  for (const TagFamily family :
       {TagFamily::tag36h11, TagFamily::tag16h5, TagFamily::aruco_4x4_50}) {
    const TagBoard board = tag_board_of(family).value();
    EXPECT_EQ(board.tag_size_m, 0.04);
    EXPECT_EQ(board.pitch_m, 0.055);
  }
  EXPECT_EQ(april_grid_of(TagFamily::tag36h11).value().tag_size_m, 0.03);
  EXPECT_EQ(april_grid_of(TagFamily::tag36h11).value().spacing, 0.3);
  EXPECT_EQ(tag_board_of(TagFamily::tag36h11, 0.03).value().pitch_m, 0.055);
  EXPECT_NEAR(tag_board_of(TagFamily::tag36h11, 0.08).value().pitch_m, 0.110, 1e-9);
  EXPECT_EQ(tag_board_of(TagFamily::tag36h11, 0.08, 0.2).value().pitch_m, 0.2);
}

class PrintedSheet : public testing::TestWithParam<std::pair<SheetTarget, const char*>> {};

// Fits only the page's position and rotation, not its scale.
TEST_P(PrintedSheet, MatchesItsTargetFile) {
  const DetectedSheet sheet =
      printed(GetParam().first, page_size_from_string(GetParam().second).value());
  EXPECT_EQ(sheet.view.problem, "");
  ASSERT_EQ(sheet.view.corners.size(), sheet.target.points.size()) << "all points must be detected";
  const auto count = static_cast<Eigen::Index>(sheet.view.corners.size());
  Eigen::Matrix2Xd measured(2, count);
  Eigen::Matrix2Xd expected(2, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const TargetCorner& corner = sheet.view.corners[static_cast<std::size_t>(i)];
    measured.col(i) = Eigen::Vector2d(corner.pixel.x(), -corner.pixel.y()) / kPixelsPerMetre;
    expected.col(i) = sheet.target.points[static_cast<std::size_t>(corner.point)].head<2>();
  }
  const Eigen::Matrix3d motion = Eigen::umeyama(expected, measured, false);
  const Eigen::Matrix2Xd off = ((motion.topLeftCorner<2, 2>() * expected).colwise() +
                                Eigen::Vector2d(motion.topRightCorner<2, 1>())) -
                               measured;
  EXPECT_LT(off.colwise().norm().maxCoeff(), 1e-4) << "0.1 mm";
  if (!sheet.target.tags) return;
  std::vector<std::uint8_t> scratch;
  TagDetector detector = TagDetector::create(sheet.target.tags->families()).value();
  EXPECT_EQ(detector.detect(luma(sheet.frame, scratch)).size(), sheet.target.tags->tags().size());
}

INSTANTIATE_TEST_SUITE_P(
    Kinds, PrintedSheet,
    testing::Values(std::pair<SheetTarget, const char*>{TagBoard{}, "a4"},
                    std::pair<SheetTarget, const char*>{AprilGrid{6, 5, 0.026, 0.25}, "a4"},
                    std::pair<SheetTarget, const char*>{AprilGrid{}, "a3"},
                    std::pair<SheetTarget, const char*>{CharucoBoard{}, "a4"},
                    std::pair<SheetTarget, const char*>{
                        CharucoBoard{7, 9, 0.02, 0.014, TagFamily::tag25h9, 2}, "letter"},
                    std::pair<SheetTarget, const char*>{
                        TagBoard{TagFamily::tag36h11, 0, 1, 1, 0.04, 0.055}, "112x100"},
                    std::pair<SheetTarget, const char*>{
                        TagBoard{TagFamily::tag36h11, 0, 1, 1, 0.04, 0.055}, "80x120"},
                    std::pair<SheetTarget, const char*>{ChessboardSheet{}, "a4"},
                    std::pair<SheetTarget, const char*>{ChessboardSheet{7, 9, 0.018}, "letter"}),
    [](const auto& test) {
      return std::vector<std::string>({"TagBoard", "AprilGrid", "CharucoBoard", "Chessboard"})
                 .at(test.param.first.index()) +
             "_" + test.param.second;
    });

// The ends of the ruler are the first and last dark pixels of the longest dark row below the board.
TEST_P(PrintedSheet, HasRulerOfHundredMillimetres) {
  const Frame frame =
      printed_page(GetParam().first, page_size_from_string(GetParam().second).value());
  std::vector<std::uint8_t> scratch;
  const ImageView page = luma(frame, scratch);
  int longest = 0;
  for (int y = 0; y < page.height; ++y) {
    int run = 0;
    for (int x = 0; x < page.width; ++x) {
      run = page.row(y)[x] < 128 ? run + 1 : 0;
      longest = std::max(longest, run);
    }
  }
  // The stroke's width and half a pixel are added at both ends.
  EXPECT_NEAR(longest / kPixelsPerMetre, 0.1, 4e-4);
}

// Compares the corners on a page of another resolution with the map, without fitting scale or
// rotation.
void expect_same_scale(const Frame& frame, double pixels_per_metre, const TagMap& map) {
  std::vector<std::uint8_t> scratch;
  const ImageView page = luma(frame, scratch);
  // Every second pixel of every second row suffices: 0.1 mm is 1.2 px at 300 dpi.
  std::vector<std::uint8_t> half;
  for (int y = 0; y < page.height; y += 2) {
    for (int x = 0; x < page.width; x += 2) half.push_back(page.row(y)[x]);
  }
  pixels_per_metre /= 2.0;
  TagDetector detector = TagDetector::create(map.families()).value();
  const int width = (page.width + 1) / 2;
  const std::vector<TagDetection> detections =
      detector.detect({half.data(), width, (page.height + 1) / 2, width});
  ASSERT_EQ(detections.size(), map.tags().size());
  for (const TagDetection& detection : detections) {
    const MappedTag* tag = map.find(detection.family, detection.id);
    ASSERT_NE(tag, nullptr);
    const MappedTag* first = map.find(detections[0].family, detections[0].id);
    const Eigen::Vector2d from_first = detection.corners_px[0] - detections[0].corners_px[0];
    const Eigen::Vector3d expected = tag->corners()[0] - first->corners()[0];
    EXPECT_NEAR(from_first.x() / pixels_per_metre, expected.x(), 1e-4);
    EXPECT_NEAR(-from_first.y() / pixels_per_metre, expected.y(), 1e-4);
  }
}

// Dots per metre in the file's pHYs chunk.
double density_of(const std::filesystem::path& png) {
  const std::vector<std::uint8_t> bytes = read_file(png).value();
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const std::size_t at = text.find("pHYs");
  EXPECT_NE(at, std::string_view::npos);
  if (at == std::string_view::npos) return 0.0;
  double density = 0.0;
  for (std::size_t i = 4; i < 8; ++i) density = 256.0 * density + bytes[at + i];
  EXPECT_EQ(bytes[at + 12], 1) << "the unit is a metre";
  return density;
}

TEST_P(PrintedSheet, IsWrittenAsPngAtTrueScale) {
  const auto& [sheet, page_name] = GetParam();
  const test::TemporaryFolder folder;
  const auto png = folder.path() / "sheet.png";
  const PageSize page = page_size_from_string(page_name).value();
  const auto written = write_sheet(png, sheet, page, SheetFormat::png);
  ASSERT_TRUE(written) << written.error().message;
  const double density = density_of(png);
  EXPECT_NEAR(density, 600.0 / 0.0254, 1.0);
  const Frame frame = load_image(png).value();
  const double longer = std::max(page.width_m, page.height_m);
  EXPECT_NEAR(std::max(frame.width, frame.height), longer * density, 1.5);
  if (const auto* board = std::get_if<TagBoard>(&sheet)) {
    expect_same_scale(frame, density, tag_map_of(*board).value());
  } else if (const auto* grid = std::get_if<AprilGrid>(&sheet)) {
    expect_same_scale(frame, density, tag_map_of(*grid).value());
  }
}

TEST_P(PrintedSheet, IsWrittenAsSvgOfPageSize) {
  const auto& [sheet, page_name] = GetParam();
  const test::TemporaryFolder folder;
  const auto svg = folder.path() / "sheet.svg";
  const PageSize page = page_size_from_string(page_name).value();
  ASSERT_TRUE(write_sheet(svg, sheet, page, SheetFormat::svg));
  const std::string text = read_text_file(svg, std::size_t{1} << 26U).value();
  const auto length_of = [&](std::string_view name) {
    const std::size_t at = text.find(std::string(name) + "=\"");
    const std::size_t begin = at + name.size() + 2;
    const std::size_t end = text.find('"', begin);
    const std::string value = text.substr(begin, end - begin);
    EXPECT_TRUE(value.ends_with("pt")) << value;
    return std::strtod(value.c_str(), nullptr) / 72.0 * 0.0254;
  };
  EXPECT_EQ(text.find("<?xml"), 0U);
  const double width = length_of("width");
  const double height = length_of("height");
  EXPECT_NEAR(std::max(width, height), std::max(page.width_m, page.height_m), 1e-5);
  EXPECT_NEAR(std::min(width, height), std::min(page.width_m, page.height_m), 1e-5);
}

TEST_P(PrintedSheet, HasTitle) {
  const test::TemporaryFolder folder;
  const auto pdf = folder.path() / "sheet.pdf";
  ASSERT_TRUE(write_sheet(pdf, GetParam().first, page_size_from_string(GetParam().second).value()));
  const auto text_file = folder.path() / "info.txt";
  const std::string command = "pdfinfo '" + pdf.string() + "' > '" + text_file.string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0);
  const std::string info = read_text_file(text_file, 100'000).value();
  EXPECT_THAT(info, testing::ContainsRegex("Title: +[A-Za-z0-9]"));
}

// Expects marks on the page's edges at the height and breadth of the board's centre (computed from
// the detected corners), and no other ink on the edges.
void expect_axes(const SheetTarget& target, double x_mark_m, double y_mark_m, double half_m) {
  const DetectedSheet sheet = printed(target, page_size_from_string("a4").value());
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (const TargetCorner& corner : sheet.view.corners) centre += corner.pixel;
  centre /= static_cast<double>(sheet.view.corners.size());
  std::vector<std::uint8_t> scratch;
  const ImageView page = luma(sheet.frame, scratch);
  const auto ink = [&](double x_m, double y_m) {  // coordinates from the board's centre, y up
    const double x = centre.x() + x_m * kPixelsPerMetre;
    const double y = centre.y() - y_m * kPixelsPerMetre;
    const int half = static_cast<int>(half_m * kPixelsPerMetre);
    int dark = 0;
    for (int j = -half; j <= half; ++j) {
      for (int i = -half; i <= half; ++i) {
        dark += page.row(static_cast<int>(y) + j)[static_cast<int>(x) + i] < 128 ? 1 : 0;
      }
    }
    return dark;
  };
  for (const double side : {-1.0, 1.0}) {
    EXPECT_GT(ink(side * x_mark_m, 0.0), 5) << "x axis";
    EXPECT_GT(ink(0.0, side * y_mark_m), 5) << "y axis";
    EXPECT_EQ(ink(side * x_mark_m, 0.02), 0);
    EXPECT_EQ(ink(0.02, side * y_mark_m), 0);
  }
}

TEST(TargetSheet, MarksAxesOnEdges) {
  expect_axes(TagBoard{}, 0.1100, 0.0825, 0.0010);  // 215 x 160 mm with its white margins
}

// The gap between the board and the page's margin is 2 mm.
TEST(TargetSheet, MarksAxesOfCharucoBoard) {
  expect_axes(CharucoBoard{}, 0.1225, 0.0920, 0.0007);  // 240 x 180 mm
}

TEST(TargetSheet, ChoosesFormatByExtension) {
  EXPECT_EQ(sheet_format_of("a.pdf").value(), SheetFormat::pdf);
  EXPECT_EQ(sheet_format_of("a.PNG").value(), SheetFormat::png);
  EXPECT_EQ(sheet_format_of("b/a.svg").value(), SheetFormat::svg);
  EXPECT_EQ(sheet_format_of("a").value(), SheetFormat::pdf);
  EXPECT_THAT(sheet_format_of("a.jpg").error().message, HasSubstr(".pdf, .svg or .png"));
}

TEST(TargetSheet, RejectsTooLargePng) {
  const test::TemporaryFolder folder;
  const auto png = folder.path() / "sheet.png";
  const auto written = write_sheet(png, TagBoard{}, {5.0, 5.0}, SheetFormat::png);
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, HasSubstr("too large"));
  EXPECT_FALSE(std::filesystem::exists(png));
}

// Tests every kind of sheet at several scales. Files of other sheets and changed files are
// rejected.
TEST_P(PrintedSheet, RecoversScaleSavedInItsFile) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "target.yaml";
  const SheetTarget& sheet = GetParam().first;
  for (const double measured_mm : {100.0, 99.2, 100.4, 50.0, 200.0, 98.7654321, 99.99}) {
    ASSERT_TRUE(save_target(file, sheet, measured_mm / 100.0));
    ASSERT_TRUE(load_target(file)) << load_target(file).error().message;
    const auto scale = printed_scale_of(file, sheet);
    ASSERT_TRUE(scale) << measured_mm;
    EXPECT_DOUBLE_EQ(*scale, measured_mm / 100.0);
  }
  EXPECT_FALSE(printed_scale_of(file, TagBoard{TagFamily::tag36h11, 7, 1, 2, 0.03, 0.05}));
  const std::string text = read_text_file(file, 1'000'000).value();
  ASSERT_TRUE(write_text_file(file, text + "# mine\n"));
  EXPECT_FALSE(printed_scale_of(file, sheet));
  EXPECT_FALSE(printed_scale_of(folder.path() / "missing.yaml", sheet));
}

TEST(TargetSheet, NumbersTagsInReadingOrderAroundCentre) {
  const TagMap map = tag_map_of(TagBoard{}).value();
  EXPECT_EQ(map.tags().size(), 12U);
  EXPECT_TRUE(map.find(TagFamily::tag36h11, 0)
                  ->T_table_tag.translation()
                  .isApprox(Eigen::Vector3d(-0.0825, 0.055, 0.0)));
  EXPECT_TRUE(map.find(TagFamily::tag36h11, 11)
                  ->T_table_tag.translation()
                  .isApprox(Eigen::Vector3d(0.0825, -0.055, 0.0)));
}

TEST(TargetSheet, ScalesTagMapByMeasuredRuler) {
  const TagMap map = tag_map_of(TagBoard{}, 0.992).value();
  EXPECT_NEAR(map.tags()[0].size_m, 0.04 * 0.992, 1e-12);
  EXPECT_NEAR(map.tags()[0].T_table_tag.translation().x(), -0.0825 * 0.992, 1e-12);
  EXPECT_FALSE(tag_map_of(TagBoard{}, 0.0992))
      << "a measured length of 99.2 mm in a wrong unit must be rejected";
}

TEST(TargetSheet, ReportsBoardThatDoesNotFitPage) {
  const test::TemporaryFolder folder;
  TagBoard board;
  board.columns = 10;
  const auto written =
      write_sheet(folder.path() / "sheet.pdf", board, page_size_from_string("a4").value());
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, HasSubstr("does not fit on a page of 210 x 297 mm"));
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "sheet.pdf"));

  // The ruler needs space, too. The page is rotated if only the rotated page has that space.
  board = TagBoard{};
  board.columns = board.rows = 1;
  const auto narrow =
      write_sheet(folder.path() / "sheet.pdf", board, page_size_from_string("80x100").value());
  ASSERT_FALSE(narrow);
  EXPECT_THAT(narrow.error().message, HasSubstr("ruler"));
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "sheet.pdf"));

  board = TagBoard{};
  board.pitch_m = 0.045;
  EXPECT_THAT(tag_map_of(board).error().message, HasSubstr("need 0.0500 m each"));
  board = TagBoard{};
  board.first_id = 580;  // the last id of 36h11 is 586
  EXPECT_FALSE(tag_map_of(board));
  board = TagBoard{};
  board.tag_size_m = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(tag_map_of(board));
  EXPECT_THAT(page_size_from_string("b9").error().message, HasSubstr("a4"));
  EXPECT_FALSE(page_size_from_string("210x"));
  EXPECT_FALSE(write_sheet(folder.path() / "no-such-folder" / "sheet.pdf", TagBoard{},
                           page_size_from_string("a4").value()));
}

}  // namespace
}  // namespace penumbra
