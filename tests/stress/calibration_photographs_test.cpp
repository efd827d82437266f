// Real photographs: our calibration must fit as well as OpenCV's on the same corners, and better on
// held-out views.
#include <gtest/gtest.h>

#include "app/calibration/image_folder.hpp"
#include "calib/target/target.hpp"
#include "calib/target/target_detector.hpp"
#include "support/opencv_calibration.hpp"
#include "support/paths.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

struct Photographs {
  const char* folder;
  int columns;  // number of inner corners
  int rows;
  std::size_t views;
  bool charuco = false;  // first markers of DICT_4X4_50
};

Target target_of(const Photographs& set) {
  constexpr double kSquare_m = 0.0254;
  if (!set.charuco) return chessboard_target(set.columns, set.rows, kSquare_m).value();
  CharucoBoard board;
  board.columns = set.columns + 1;
  board.rows = set.rows + 1;
  board.square_m = kSquare_m;
  board.tag_m = 0.75 * kSquare_m;
  board.family = TagFamily::aruco_4x4_50;
  return charuco_target(board).value();
}

class CalibrationPhotographs : public testing::TestWithParam<Photographs> {};

TEST_P(CalibrationPhotographs, FitAsWellAsOpenCvAndBetterOnHeldOutViews) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no photographs beside the checkout";
  const Target target = target_of(GetParam());
  TargetDetector detector = TargetDetector::create(target).value();
  std::vector<CalibrationView> views;
  int width = 0;
  int height = 0;
  const auto read = for_each_image(test::shared_dir() / "data" / "real" / GetParam().folder,
                                   [&](const NamedImage& image) -> Result<bool> {
                                     width = image.luma.width;
                                     height = image.luma.height;
                                     const TargetView view = detector.detect(image.luma);
                                     if (view.problem.empty())
                                       views.push_back({image.name, view.corners});
                                     return true;
                                   });
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_GE(views.size(), GetParam().views);
  const auto peer = test::opencv_calibration(width, height, target.points, views);
  ASSERT_TRUE(peer);
  auto without_outliers = views;
  for (CalibrationView& view : without_outliers) view.outlier.assign(view.corners.size(), false);
  const auto solved = solve_intrinsics(width, height, target.points, without_outliers);
  ASSERT_TRUE(solved) << solved.error().message;
  // Both solvers approach the same minimum, but OpenCV stops slightly before it.
  EXPECT_LE(solved->rms_all_px, peer->rms_px * 1.0001);
  EXPECT_GE(solved->rms_all_px, peer->rms_px * 0.99);

  const auto peer_held = test::held_out_px(views, [&](const auto& kept) {
    return test::opencv_calibration(width, height, target.points, kept);
  });
  SolverOptions options;
  options.shape = BoardShape::free;
  const auto held =
      test::held_out_px(views, [&](const auto& kept) -> std::optional<test::CameraAndBoard> {
        const auto found = solve_intrinsics(width, height, target.points, kept, options);
        if (!found) return std::nullopt;
        return test::CameraAndBoard{found->camera, found->board, found->rms_all_px};
      });
  ASSERT_TRUE(peer_held && held);
  EXPECT_LT(*held, *peer_held);
}

// Returns one set of photographs for each kind of target; in the nightly form all sets.
std::vector<Photographs> sets() {
  std::vector<Photographs> sets = {{"opencv-chessboard", 9, 6, 13},
                                   {"photonvision-calib/charuco-lifecam-480", 7, 7, 15, true}};
  if (test::nightly()) {
    sets.push_back({"swatbotics/calibration", 7, 5, 15});
    sets.push_back({"photonvision-calib/squares-lifecam-480", 10, 10, 14});
    sets.push_back({"photonvision-calib/squares-gloworm-320x240", 8, 6, 24});
  }
  return sets;
}

INSTANTIATE_TEST_SUITE_P(Real, CalibrationPhotographs, testing::ValuesIn(sets()),
                         [](const auto& test) {
                           std::string name = test.param.folder;
                           std::ranges::replace_if(
                               name, [](char c) { return c == '/' || c == '-'; }, '_');
                           return name;
                         });

}  // namespace
}  // namespace penumbra
