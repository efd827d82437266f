// Photographs of one of OpenCV's ChArUco boards, from a webcam.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <vector>

#include "calib/camera_calibration.hpp"
#include "core/image/image_file.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

CharucoBoard photographed_board() {
  CharucoBoard board;
  board.columns = board.rows = 8;
  board.square_m = 0.0254;
  board.tag_m = 0.75 * board.square_m;
  board.family = TagFamily::aruco_4x4_50;
  return board;
}

Result<CameraCalibration> calibrate_from(const CharucoBoard& board) {
  CalibrationOptions options;
  options.model = DistortionModel::plumb_bob;
  options.shape = BoardShape::rigid;
  auto calibrator = CameraCalibrator::create(charuco_target(board).value(), options);
  if (!calibrator) return tl::unexpected(calibrator.error());
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(
           test::shared_dir() / "data" / "real" / "photonvision-calib" / "charuco-lifecam-480"))
    files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::vector<std::uint8_t> scratch;
  for (const auto& file : files) {
    const auto frame = load_image(file);
    if (!frame) return tl::unexpected(frame.error());
    if (auto added = calibrator->add(file.filename().string(), luma(*frame, scratch)); !added)
      return tl::unexpected(added.error());
  }
  return calibrator->finish();
}

// Markers are detected even if their size differs from that in the target file.
TEST(CharucoPhotographs, ReportMarkerSizeThatDiffersFromFile) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no photographs beside the checkout";
  for (const double fraction : {0.68, 0.82}) {
    CharucoBoard board = photographed_board();
    board.tag_m = fraction * board.square_m;
    const auto result = calibrate_from(board);
    ASSERT_FALSE(result) << fraction;
    EXPECT_THAT(result.error().message,
                testing::HasSubstr("of a square wide, but the target file says"));
    const auto digits = result.error().message.find("0.7");
    EXPECT_NE(digits, std::string::npos)
        << "a marker is three quarters of a square wide: " << result.error().message;
  }
}

TEST(CharucoPhotographs, YieldCalibration) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no photographs beside the checkout";
  const auto result = calibrate_from(photographed_board());
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_GE(result->solution.views.size(), 15U);
  // Most of the 49 corners must be found in most views.
  EXPECT_GE(result->solution.corners, 15 * 40);
  ASSERT_TRUE(result->held_out_px);
  EXPECT_LT(*result->held_out_px, 0.2);
  // The views cover a small fraction of the image, so the verdict is poor.
  EXPECT_EQ(result->grade, CalibrationGrade::poor);
  RecordProperty("fx", std::to_string(result->solution.camera.parameters().fx));
  RecordProperty("held_out_px", std::to_string(*result->held_out_px));
}

}  // namespace
}  // namespace penumbra
